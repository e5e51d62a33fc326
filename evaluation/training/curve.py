"""Draw the learning curves of a training run: the training loss or reward, and the validation score."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, standalone
from activestructure_gym.evaluation.training.config import Method

_TRAINING = {"ppo": ("rollout/reward_per_episode", "reward per training episode")}
_LOSS = ("train/loss", "loss")
_VALIDATION = ("validation/normalised", "validation: 0 = random, 1 = oracle")


def learning_curve(method: Method, rows: Sequence[Mapping[str, Any]]) -> str | None:
    """Return an SVG with two charts over the epochs or iterations: training loss or reward, and validation score.

    ``rows`` are the lines of ``log.jsonl``. Return None if no row has a number to draw.
    """
    unit = "iteration" if method == "ppo" else "epoch"
    charts, names = [], []
    for index, (key, label) in enumerate((_TRAINING.get(method, _LOSS), _VALIDATION)):
        points = [(row["unit"], row[key]) for row in rows if _is_number(row.get(key))]
        if not points:
            continue
        x, y = np.array(points, np.float64).T
        name = "validation" if key.startswith("validation/") else "training"
        holds = (0.0, 1.0) if name == "validation" else ()  # the axis always shows 0 and 1, so small changes look small
        line = Line(name, index, x, y)
        charts.append(line_chart([line], title=f"{method}: {label}", x_label=unit, y_label=label, y_includes=holds))
        names.append(name)
    return standalone([charts], names, title=f"asg train {method}") if charts else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)
