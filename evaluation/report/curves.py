"""Convergence: completion ratio and PSNR over the frames and the metres that were paid for them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.store import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MEASURES = (("completion_ratio", "C.R. at 5 cm [%]"), ("psnr", "PSNR of held-out views [dB]"))
_COSTS = (("frames", "frames"), ("metres", "path length [m]"))
_POINTS = 200  # of the common grid that seeds are averaged on


def curve_of(run: Run, cost: str, measure: str) -> tuple[np.ndarray, np.ndarray]:
    """Points of one run's curve, cost rising strictly (of equal costs the last counts)."""
    points = {point[cost]: point[measure] for point in run.metrics["curve"]}
    cost_values = np.array(sorted(points), dtype=np.float64)
    return cost_values, np.array([points[value] for value in sorted(points)], dtype=np.float64)


def band(curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Grid, mean, lowest and highest of several curves, as far as all of them reach."""
    start = max(float(x[0]) for x, _ in curves)
    end = min(float(x[-1]) for x, _ in curves)
    grid = np.linspace(start, max(start, end), _POINTS)
    values = np.stack([np.interp(grid, x, y) for x, y in curves])
    return grid, values.mean(axis=0), values.min(axis=0), values.max(axis=0)


def policy_curves(runs: Sequence[Run], cost: str, measure: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """One curve per seed: the run's own, or with several scenes the mean over them."""
    by_seed: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    for run in runs:
        by_seed.setdefault(run.job.seed, []).append(curve_of(run, cost, measure))
    return [curves[0] if len(curves) == 1 else band(curves)[:2] for curves in by_seed.values()]


def plot_convergence(runs: Sequence[Run], path: Path, *, title: str) -> None:
    """One line per policy: the mean over its seeds, with a band from the lowest to the highest of them.

    Every seed is also drawn thinly to its own end, which may lie beyond the mean's.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1)  # inches
    figure = Figure(figsize=(10.5, 7.2), dpi=140, layout=layout)
    axes = figure.subplots(len(_MEASURES), len(_COSTS), sharey="row", squeeze=False)
    policies = list(dict.fromkeys(run.job.policy for run in runs))
    for row, (measure, measure_label) in enumerate(_MEASURES):
        for column, (cost, cost_label) in enumerate(_COSTS):
            axis = axes[row][column]
            for index, policy in enumerate(policies):
                own = [run for run in runs if run.job.policy == policy]
                _draw(axis, index, policy, policy_curves(own, cost, measure))
            _dress(axis, cost_label if row == len(_MEASURES) - 1 else "", measure_label if column == 0 else "")
    figure.suptitle(title, fontsize=14, fontweight="bold", x=0.01, ha="left")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=min(5, len(labels)),
        frameon=False,
        fontsize=11,
        title=_reading_aid(runs),
    )
    with warnings.catch_warnings():  # a scene's name may hold letters the font lacks; the curves do not
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(path)


def _reading_aid(runs: Sequence[Run]) -> str:
    seeds = len({run.job.seed for run in runs})
    scenes = len({run.scene for run in runs})
    line = f"mean of {seeds} seeds" if seeds > 1 else "one seed"
    line += f" on {scenes} scenes" if scenes > 1 else ""
    return line + (", band from the lowest to the highest" if seeds > 1 else "")


def _draw(axis: Axes, index: int, label: str, curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    look: dict[str, Any] = {"color": style.colour(index), "linestyle": style.DASHES[index % len(style.DASHES)]}
    if len(curves) == 1:
        x, mean = curves[0]
    else:
        x, mean, low, high = band(curves)
        axis.fill_between(x, low, high, color=style.colour(index), alpha=0.15, linewidth=0)
        for own_x, own_y in curves:
            axis.plot(own_x, own_y, **look, linewidth=0.6, alpha=0.45)
    axis.plot(x, mean, **look, linewidth=2.2, label=label)
    marker = style.MARKERS[index % len(style.MARKERS)]
    axis.plot(x[-1:], mean[-1:], marker=marker, markersize=8, color=style.colour(index), markeredgecolor="white")


def _dress(axis: Axes, x_label: str, y_label: str) -> None:
    axis.set_xlabel(x_label, fontsize=11)
    axis.set_ylabel(y_label, fontsize=11)
    axis.set_xlim(left=0)
    axis.grid(color="#e3e6e8", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=10, color="#adb5bd")
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color("#adb5bd")
