"""Make docs/images/replay.webp, the film of README: the maps of two runs as they grow.

    python docs/images/replay.py runs/benchmark

The runs are of benchmark.csv (docs/notebook/benchmark.md); `cell.py` chooses scene and seed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cell import BASE, OURS, runs_of_cell, write_record

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.replay import play_again, write_video

OUT = Path(__file__).with_name("replay.webp")


def main(comparison: Path) -> None:
    """Replay the two runs of a comparison's directory, and write the film."""
    runs = runs_of_cell(comparison, (BASE, OURS))
    recordings = [play_again(run) for run in runs]
    if differs := [one.divergence for one in recordings if one.divergence]:
        raise InputError(f"the runs are not those of this code: {differs[0]}")
    write_video(recordings, OUT)
    write_record(runs, OUT)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("give the directory of the comparison: python docs/images/replay.py DIR")
    try:
        main(Path(sys.argv[1]))
    except InputError as error:
        sys.exit(f"replay.py: {error}")
