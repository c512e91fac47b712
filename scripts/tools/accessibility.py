"""Checks pages for accessibility: axe-core's findings in headless Chromium.

    python -m scripts.tools.accessibility axe.min.js results/index.html [--width 390] [--dark]

`axe.min.js` is in the npm package `axe-core` (`npm pack axe-core`). Exit code 1 if a finding is
serious or critical.
"""

import argparse
import html
import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any


# Milliseconds of the page's own time, in which charts are drawn before axe runs and answers.
DRAWING, BUDGET = 8_000, 30_000
RESULT = "axe-result"


def findings(page: Path, axe: str, width: int = 1280, dark: bool = False) -> list[dict[str, Any]]:
    """Return axe-core's violations of a page.

    **Raises** `RuntimeError` where Chromium is missing or gives no answer.
    """
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise RuntimeError("chromium: not found; expected Chromium or Chrome on the path")
    answer = (
        f"setTimeout(() => axe.run().then((r) => {{ const p = document.createElement('pre');"
        f" p.id = '{RESULT}'; p.textContent = JSON.stringify(r.violations);"
        f" document.body.append(p); }}), {DRAWING});"
    )
    text = page.read_text("utf-8")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "page.html"
        scripts = f"<script>{axe}</script><script>{answer}</script></body>"
        copy.write_text(scripts.join(text.rsplit("</body>", 1)), encoding="utf-8")
        line = [
            program,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            f"--window-size={width},900",
        ]
        line += ["--blink-settings=preferredColorScheme=0"] if dark else []
        line += [f"--virtual-time-budget={BUDGET}", "--dump-dom", copy.as_uri()]
        done = subprocess.run(line, capture_output=True, text=True, timeout=300)
    found = re.search(rf'<pre id="{RESULT}">(.*?)</pre>', done.stdout, re.DOTALL)
    if found is None:
        raise RuntimeError(f"{page}: no answer of axe-core: {done.stderr.strip()[-200:]}")
    return json.loads(html.unescape(found[1]))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("axe", type=Path, help="axe.min.js")
    parser.add_argument("pages", type=Path, nargs="+")
    parser.add_argument("--width", type=int, default=1280, help="of the window [pixels]")
    parser.add_argument("--dark", action="store_true", help="as a system in dark mode shows it")
    options = parser.parse_args(argv)
    serious = 0
    for page in options.pages:
        violations = findings(page, options.axe.read_text("utf-8"), options.width, options.dark)
        print(f"{page}: {len(violations)} findings")
        for finding in violations:
            print(f"  {finding['impact']}: {finding['help']} ({len(finding['nodes'])} places)")
            serious += finding["impact"] in ("serious", "critical")
    return int(serious > 0)


if __name__ == "__main__":
    raise SystemExit(main())
