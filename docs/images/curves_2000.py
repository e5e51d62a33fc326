"""Make curves_2000.svg: quality and coverage over long episodes, with one line per run of one or more comparisons.

    asg compare --scenes SCENE [SCENE ...] --frames 2000 --policies unknown_volume --out runs/long
    python docs/images/curves_2000.py runs/long

A table is printed too. It has the final value and the minimum of each curve, and its largest fall from a checkpoint to
a later one.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.charts.convergence import curve_of
from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, standalone, value_range
from activestructure_gym.evaluation.report.results import gather

ROWS = (
    (
        ("completion_ratio", "C.R. of the means [%]"),
        ("observed", "surface observed [%]"),
    ),
    (("precision", "precision of the means [%]"), ("psnr", "PSNR of 8 held-out views [dB]")),
)
FIRST = 100  # first frame of the figure; the first views show a fifth of the surface, which would flatten the curves


def main(directories: Sequence[Path]) -> None:
    """Draw the curves of all runs in the given comparison directories, and print the table."""
    runs = gather(list(directories)).runs
    names = [f"{run.policy}, {run.scene}, seed {run.job.seed}" for run in runs]
    charts = []
    for row in ROWS:
        drawn = []
        for measure, label in row:
            lines = [line(run, name, index, measure) for index, (run, name) in enumerate(zip(runs, names))]
            drawn.append(line_chart(lines, title=label, x_label="frames", y_label=label, y_includes=value_range(lines)))
        charts.append(drawn)
    picture = standalone(charts, names, title="The map over 2,000 frames")
    Path(__file__).with_name("curves_2000.svg").write_text(picture, encoding="utf-8")
    for run, name in zip(runs, names):
        print(name, *(summary(run, measure) for row in ROWS for measure, _ in row), sep=" | ")


def line(run: Run, name: str, index: int, measure: str) -> Line:
    """Return the curve of one metric of a run from frame `FIRST` on; ``index`` selects its colour."""
    frames, values = curve_of(run, "frames", measure)
    later = frames >= FIRST
    return Line(name, index, frames[later], values[later])


def summary(run: Run, measure: str) -> str:
    """Return the last value, the minimum, and the largest fall from a checkpoint to a later one, as text."""
    values = curve_of(run, "frames", measure)[1]
    fall = float((np.maximum.accumulate(values) - values).max())
    return f"{measure} {values[-1]:.2f}, least {values.min():.2f}, falls by {fall:.2f}"


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("give the directory of a comparison: python docs/images/curves_2000.py DIR [DIR ...]")
    try:
        main([Path(argument) for argument in sys.argv[1:]])
    except InputError as error:
        sys.exit(f"curves_2000.py: {error}")
