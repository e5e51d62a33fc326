"""Makes views.jpg, README's first picture, of the report of a comparison:

    asg compare --scenes "room?seed=12,hotel_room.glb?up=z" --policies random,pixel_only,activestructure \\
        --out runs/views
    python docs/images/views.py runs/views

Nobody picks the view: it is the one that the report shows first (docs/guide/report.md). Several directories, of
comparisons or of single runs, are read as one.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.report.pictures import compare_strip
from activestructure_gym.evaluation.report.results import gather


def main(directories: list[Path]) -> None:
    """The strips of all scenes, one below the other."""
    results = gather(directories)
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
    if len(sys.argv) < 2:
        sys.exit("give the directory of a comparison: python docs/images/views.py DIR [DIR ...]")
    try:
        main([Path(argument) for argument in sys.argv[1:]])
    except InputError as error:
        sys.exit(f"views.py: {error}")
