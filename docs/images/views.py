"""Make docs/images/views.jpg, the image of README, from runs of benchmark.csv (docs/notebook/benchmark.md).

    python docs/images/views.py runs/benchmark

The view is that at the top of a report (docs/reference/report.md); `cell.py` chooses scene and seed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cell import runs_of_cell, write_record

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.report.pictures.views_and_plans import compare_strip

OUT = Path(__file__).with_name("views.jpg")
POLICIES = ("random", "hole_area", "activestructure")


def main(comparison: Path) -> None:
    """Draw a true view, the same view rendered from each policy's map, and each map from above, as one image.

    ``comparison`` is the directory of the runs.
    """
    runs = runs_of_cell(comparison, POLICIES)
    title = f"{runs[0].scene}, {runs[0].metrics['metrics']['frames']} frames, seed {runs[0].job.seed}"
    compare_strip(runs, title=title).save(OUT, quality=84, optimize=True, progressive=True)
    write_record(runs, OUT)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("give the directory of the comparison: python docs/images/views.py DIR")
    try:
        main(Path(sys.argv[1]))
    except InputError as error:
        sys.exit(f"views.py: {error}")
