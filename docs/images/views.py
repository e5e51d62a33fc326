"""Makes views.jpg, README's first picture, of the report of a comparison:

    asg compare --scenes "room,hotel_room.glb?up=z" --policies random,activestructure-a,activestructure --seeds 0,1,2 \\
        --frames 300 --out runs/views
    python docs/images/views.py runs/views

Nobody picks seed or view: both are those that the report shows first (docs/guide/report.md).
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from activestructure_gym.evaluation.report.pictures import compare_strip
from activestructure_gym.evaluation.report.results import gather


def main(directory: Path) -> None:
    """The strips of all scenes, one below the other."""
    results = gather([directory])
    pages = []
    for scene in results.scenes:
        runs = results.foremost(scene)
        title = f"{scene.partition('?')[0]}, {runs[0].metrics['metrics']['frames']} frames, seed {runs[0].job.seed}"
        pages.append(compare_strip(runs, title=title))
    whole = Image.new("RGB", (max(page.width for page in pages), sum(page.height for page in pages)), "white")
    for number, page in enumerate(pages):
        whole.paste(page, (0, sum(above.height for above in pages[:number])))
    whole.save(Path(__file__).with_name("views.jpg"), quality=84, optimize=True, progressive=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
