"""Make docs/images/replay.webp, the animation of README: a replay of two runs, recorded in headless Chromium.

    python docs/images/replay.py runs/headline

The runs are of headline.csv (docs/notebook/benchmark.md); `cell.py` chooses scene and seed. This program needs Chromium
and the extra ``test``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
from cell import BASE, OURS, runs_of_cell, write_record
from PIL import Image

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.replay import play_again, write_replay

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.browser import open_page

OUT = Path(__file__).with_name("replay.webp")
WIDTH, HEIGHT, PICTURES, MS = 1300, 1060, 80, 120  # window in pixels, number of images, milliseconds per image
SHOWN = 860  # width of the animation in pixels


def main(comparison: Path) -> None:
    """Replay the two runs of a comparison's directory, record the page, and write the animation."""
    runs = runs_of_cell(comparison, (BASE, OURS))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        page_file = Path(folder) / "replay.html"
        write_replay([play_again(run) for run in runs], page_file)
        with open_page(page_file.as_uri(), Path(folder), width=WIDTH, height=HEIGHT) as page:
            page.until("window.player && player.drawn > 0")
            frames = []
            for n in range(PICTURES):
                # The view turns slowly while time runs; the last 12 images show the end of the episode.
                share = min(n / (PICTURES - 12), 1.0)
                turn = f"for (const run of player.runs) run.orbit.yaw = run.orbit.home.yaw + {0.5 * share};"
                page.value(f"{turn} player.to(1 + {share} * (player.end - 1)); 1")
                page.until("player.dirty === false")
                shown = cv2.cvtColor(page.picture(), cv2.COLOR_BGR2RGB)
                picture = Image.fromarray(shown)
                frames.append(picture.resize((SHOWN, round(picture.height * SHOWN / picture.width)), Image.LANCZOS))
    frames[0].save(OUT, save_all=True, append_images=frames[1:], duration=MS, loop=0, quality=55, method=6)
    write_record(runs, OUT)
    print(f"{OUT}: {len(frames)} pictures, {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("give the directory of the comparison: python docs/images/replay.py DIR")
    try:
        main(Path(sys.argv[1]))
    except InputError as error:
        sys.exit(f"replay.py: {error}")
