"""Make paper_curves.json, the curves of the paper's variants at the paper's size, and draw paper_curves.svg.

    python docs/images/paper_curves.py runs/paper    # add the runs of a comparison
    python docs/images/paper_curves.py               # draw only

Curves are means over the runs of a policy (docs/notebook/native.md, "The paper's size").
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.report.charts.convergence import curve_of
from activestructure_gym.evaluation.report.charts.episode_series import graph_series
from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, standalone, value_range
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.policies.activestructure import LADDER

FRAMES = np.arange(50, 2001, 50)
_FIRST = 4  # first point of a drawn curve; all variants begin alike, which would flatten the curves
PLACE = Path(__file__).with_suffix(".json")
PANELS = {"psnr": "PSNR [dB]", "deficiency_area": "deficient area of planes [m²]"}


def added(directories: Sequence[Path]) -> None:
    """Add the curves of the runs in comparison directories to paper_curves.json, by policy, scene and seed."""
    content = json.loads(PLACE.read_text(encoding="utf-8")) if PLACE.exists() else {}
    for run in gather(directories).runs:
        series = {
            "psnr": curve_of(run, "frames", "psnr"),
            "deficiency_area": graph_series(run.steps, "deficiency_area"),
        }
        curves = {name: np.interp(FRAMES, *curve).round(2).tolist() for name, curve in series.items()}
        content.setdefault(run.policy, {})[f"{run.scene} {run.job.seed}"] = curves
    PLACE.write_text(json.dumps(content, separators=(",", ":"), sort_keys=True) + "\n", encoding="utf-8")


def drawn() -> str:
    """Return a chart per measure over the frames as SVG text, with a line per variant."""
    content = json.loads(PLACE.read_text(encoding="utf-8"))
    names = [rung for rung in LADDER if rung in content]
    charts = []
    for measure, label in PANELS.items():
        curves = [np.mean([run[measure] for run in content[name].values()], axis=0)[_FIRST:] for name in names]
        frames = FRAMES[_FIRST:].astype(float)
        lines = [Line(name, index, frames, curve) for index, (name, curve) in enumerate(zip(names, curves))]
        low, high = value_range(lines)
        charts.append(line_chart(lines, title=label, x_label="frames", y_label=label, y_includes=(low, high)))
    return standalone([charts], names, title="The paper's variants over 2,000 frames at the paper's size")


if __name__ == "__main__":
    if sys.argv[1:]:
        try:
            added([Path(word) for word in sys.argv[1:]])
        except InputError as error:
            sys.exit(f"paper_curves.py: {error}")
    PLACE.with_suffix(".svg").write_text(drawn(), encoding="utf-8")
