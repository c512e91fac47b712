"""Take the pictures of docs/report.md: a report's page in headless Chromium.

    python -m scripts.tools.report_pictures

The report is that of `jaxcslc example panda`, by the command that the example names. It takes half
a minute. Run it after a change of the page.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path


IMAGES = Path(__file__).parents[2] / "docs" / "images"
# File name, height [pixels], and the rules by which the page shows one part alone.
_PICTURES = {
    "report.png": (850, ""),
    "report_torque.png": (
        600,
        "header, nav, main > :not(#measured-and-predicted-torque) { display: none }",
    ),
}
_WIDTH, _DRAWING = 1100, 8_000  # pixels; milliseconds of the page's own time to draw charts


def identified(folder: Path) -> Path:
    """Identify the example's Panda, and return the page."""
    command = [sys.executable, "-m", "jaxcslc"]
    subprocess.run([*command, "example", "panda"], cwd=folder, check=True)
    files = ["panda.urdf", "train.csv", "--validate", "validation.csv", "-o", "results"]
    subprocess.run([*command, "identify", *files], cwd=folder / "panda", check=True)
    return folder / "panda" / "results" / "index.html"


def main() -> int:
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        print("chromium: not found; expected Chromium or Chrome on the path", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as scratch:
        page = identified(Path(scratch))
        text = page.read_text("utf-8")
        for name, (height, rules) in _PICTURES.items():
            page.write_text(text.replace("</head>", f"<style>{rules}</style></head>", 1), "utf-8")
            line = [program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
            line += [f"--window-size={_WIDTH},{height}", f"--virtual-time-budget={_DRAWING}"]
            subprocess.run([*line, f"--screenshot={IMAGES / name}", page.as_uri()], check=True)
    print(f"wrote {', '.join(_PICTURES)} into {IMAGES}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
