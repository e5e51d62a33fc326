"""Make docs/images/report.jpg, the image of a report in the guide: the top of the page, and next to it later parts.

    python docs/images/report.py REPORT.html

This program needs Chromium and the extra ``test``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.browser import Page, open_page

OUT = Path(__file__).with_name("report.jpg")
WIDTH, HEIGHT = 1160, 2000  # size of the browser window and of the left part in pixels
# CSS selectors of the right part, with their heights in pixels: two rows of charts, then views and plans of one scene.
RIGHT = {"#convergence": 738, "#scene-2 .strip": 800, "#scene-2 .tiles": 700}
SHOWN = 1560  # width of the image in pixels


def main(words: list[str]) -> None:
    """Open the report ``words[0]`` in a browser, capture its parts, and write them next to each other as one image."""
    if len(words) != 1:
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        link = Path(words[0]).resolve().as_uri()
        with open_page(link, Path(folder), width=WIDTH, height=HEIGHT) as page:
            page.value("document.querySelectorAll('img').forEach((one) => { one.loading = 'eager'; }), 1")
            page.until("[...document.images].every((one) => one.complete)")
            left = page.picture()
            right = np.vstack([part(page, name)[:most] for name, most in RIGHT.items()])
    height = min(len(left), len(right))
    both = np.hstack([left[:height], right[:height]])
    both = cv2.resize(both, (SHOWN, round(height * SHOWN / both.shape[1])), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(OUT), both, [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(f"{OUT}: {both.shape[1]} x {both.shape[0]}, {OUT.stat().st_size / 1e3:.0f} kB")


def part(page: Page, name: str) -> np.ndarray:  # [h, WIDTH, 3] uint8
    """Return a screenshot of the page's rows that show the element with the CSS selector ``name``."""
    page.value(f"document.querySelector('{name}').scrollIntoView(), 1")
    page.value("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")
    top, end = page.value(
        f"(({{ top, bottom }}) => [top, bottom])(document.querySelector('{name}').getBoundingClientRect())"
    )
    return page.picture()[max(round(top), 0) : round(end) + 12]


if __name__ == "__main__":
    main(sys.argv[1:])
