"""Draw the pictures of docs/gallery.md by the code that the page shows.

    python -m scripts.tools.gallery

The first block prepares. Each other block draws one figure, which is stored under the name of its
heading in docs/images/gallery.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image


PAGE = Path(__file__).parents[2] / "docs" / "gallery.md"
FOLDER = PAGE.parent / "images" / "gallery"
_COLOURS = 64  # of a stored picture


def blocks() -> list[tuple[str, str]]:
    """Heading and code of each block of the page."""
    parts = re.split(r"^#+ (.+)$", PAGE.read_text("utf-8"), flags=re.MULTILINE)
    code = (re.findall(r"```python\n(.*?)```", text, re.DOTALL) for text in parts[2::2])
    return [(title, lines[0]) for title, lines in zip(parts[1::2], code, strict=True) if lines]


def figures(names: list[str] | None = None) -> Iterator[tuple[str, Figure]]:
    """Name and figure of each block, or of those named, in the order of the page."""
    (_, preparation), *drawing = blocks()
    scope: dict[str, Any] = {}
    exec(compile(preparation, "gallery.md", "exec"), scope)
    for title, code in drawing:
        name = "-".join(re.sub(r"[^a-z ]", "", title.lower()).split())
        if names is not None and name not in names:
            continue
        exec(compile(code, f"gallery.md, {title}", "exec"), scope)
        figure = plt.gcf()
        yield name, figure
        plt.close(figure)


def main() -> None:
    plt.switch_backend("agg")
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, figure in figures():
        path = FOLDER / f"{name}.png"
        figure.savefig(path, dpi=100, bbox_inches="tight")
        Image.open(path).convert("RGB").quantize(_COLOURS).save(path, optimize=True)
        print(f"wrote {path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
