"""Make tables and figures of the mapping benchmarks: quality on held-out views, and time over the size of the map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.evaluation.metrics.image import depth_l1, psnr, ssim
from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import corner_label, tile_grid, to_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL import Image

    from benchmarks.growth import GrowthRow
    from benchmarks.mapping import MappedViews, MappingCourse

_RECIPE = ("mapper", "iterations")  # columns that identify a recipe
MEAN = "mean"  # entry of the column "scene" in rows with means over all scenes
_ENLARGED = 2  # factor by which views are enlarged, without smoothing


def quality_row(course: MappingCourse, mapped: MappedViews) -> dict[str, Any]:
    """Return a row with image quality, depth error and cost of one mapper configuration on one scene.

    ``course`` holds the true held-out views, and ``mapped`` the same views rendered from the map. ``depth_cm`` is the
    mean over the views of their mean depth error at pixels with a true surface. A pixel without Gaussians has its whole
    depth as error. ``median_depth_cm`` is the median over the pixels that the map covers, which is robust against wrong
    edges.
    """
    images = [frame.rgb.astype(np.float64) / 255.0 for frame in course.truth]
    depths = [frame.depth for frame in course.truth]
    errors = [depth_l1(shown, true) for shown, true in zip(mapped.depth, depths)]
    off = [np.abs(s - t)[(t > 0) & (s > 0)] for s, t in zip(mapped.depth, depths)]
    return {
        "scene": mapped.scene,
        "mapper": mapped.recipe.mapper,
        "iterations": mapped.recipe.iterations,
        "psnr_db": float(np.mean([psnr(shown, true) for shown, true in zip(mapped.color, images)])),
        "ssim": float(np.mean([ssim(shown, true) for shown, true in zip(mapped.color, images)])),
        "depth_cm": 100.0 * float(np.mean([error for error in errors if error is not None])),
        "median_depth_cm": 100.0 * float(np.median(np.concatenate(off))),
        "gaussians": mapped.gaussians,
        "event_ms": 1e3 * mapped.event_seconds,
    }


def with_means(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows, followed by one row per recipe with means over the scenes."""
    recipes = list(dict.fromkeys(tuple(row[key] for key in _RECIPE) for row in rows))
    means = []
    for recipe in recipes:
        own = [row for row in rows if tuple(row[key] for key in _RECIPE) == recipe]
        numbers = [key for key in own[0] if key not in ("scene", *_RECIPE)]
        averaged = {key: float(np.mean([row[key] for row in own])) for key in numbers}
        means.append({"scene": MEAN, **dict(zip(_RECIPE, recipe)), **averaged})
    return [*rows, *means]


def quality_strip(
    courses: Sequence[MappingCourse],
    mapped: Sequence[Sequence[MappedViews]],  # for every course, the results of all recipes
    *,
    shown: Sequence[str] = ("default at 5", "splatam at 15"),
) -> Image.Image:
    """Draw one row per scene: a true held-out view, and the same view rendered from the maps of the recipes ``shown``.

    The held-out view with the most detail in its true image is taken, so the choice does not depend on the maps.
    """
    rows, labels = [], []
    for course, entries in zip(courses, mapped):
        detail = [np.abs(np.diff(frame.rgb.astype(np.float32), axis=1)).mean() for frame in course.truth]
        index = int(np.argmax(detail))
        true = course.truth[index].rgb
        tiles = [_enlarged(true)]
        for entry in entries:
            if str(entry.recipe) in shown:
                tile = _enlarged(np.rint(255.0 * entry.color[index]).astype(np.uint8))
                corner_label(tile, f"{psnr(entry.color[index], true / 255.0):.1f} dB")
                tiles.append(tile)
        rows.append(tiles)
        labels.append([entries[0].scene])
    columns = ["true view", *(str(entry.recipe) for entry in mapped[0] if str(entry.recipe) in shown)]
    title = f"Held-out views after {len(courses[0].keyframes)} keyframes"
    return tile_grid(rows, title=title, row_labels=labels, column_labels=columns)


def _enlarged(image: np.ndarray) -> Image.Image:
    return to_image(image.repeat(_ENLARGED, axis=0).repeat(_ENLARGED, axis=1))


def plot_growth(rows: Sequence[GrowthRow], path: Path, *, title: str) -> None:
    """Plot the times in milliseconds, and the number of Gaussians, over the number of keyframes; write to ``path``."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(10.5, 4.2), dpi=110, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1))
    costs, sizes = figure.subplots(1, 2)
    keyframes = [row.keyframes for row in rows]
    curves: tuple[tuple[str, list[float]], ...] = (
        ("mapping event", [row.event_ms for row in rows]),
        ("keyframe PSNR, per decision", [row.decision_ms for row in rows]),
        ("scoring 256 candidates", [row.scoring_ms for row in rows]),
    )
    for index, (label, values) in enumerate(curves):
        _line(costs, index, keyframes, values, label)
    costs.set_yscale("log")
    _dress(costs, "keyframes", "processor time [ms]")
    _line(sizes, 3, keyframes, [row.gaussians for row in rows], "in the map")
    _line(sizes, 4, keyframes, [row.in_view for row in rows], "in a timed view")
    _dress(sizes, "keyframes", "Gaussians")
    figure.suptitle(title, fontsize=13, fontweight="bold", x=0.01, ha="left")
    figure.savefig(path, pil_kwargs={"quality": 85} if path.suffix in (".jpg", ".jpeg") else None)


def _line(axis: Axes, index: int, x: Sequence[float], y: Sequence[float], label: str) -> None:
    axis.plot(
        x,
        y,
        color=style.colour(index),
        linestyle=style.DASHES[index % len(style.DASHES)],
        marker=style.MARKERS[index % len(style.MARKERS)],
        markersize=5,
        label=label,
    )


def _dress(axis: Axes, x_label: str, y_label: str) -> None:
    axis.set_xlabel(x_label)
    axis.set_ylabel(y_label)
    axis.set_xlim(left=0)
    axis.grid(color="#e3e6e8", linewidth=0.8)
    axis.legend(frameon=False, fontsize=9)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
