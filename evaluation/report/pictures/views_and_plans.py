"""Compose true and rendered views, and plans with paths, for one run or for several runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import (
    GAP,
    MARGIN,
    corner_label,
    text_width,
    tile_grid,
    to_image,
    write,
)
from activestructure_gym.evaluation.report.pictures.floor_plan import camera_height_text, draw_plan, legend
from activestructure_gym.evaluation.report.tables.layout import decimal

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.store import Run

_SHOWN_VIEWS = 4
TRUE, CAPTURED = "true", "captured"  # names of reference images: true held-out views, or captured keyframes
BLACK_NOTE = "Black: the map has no Gaussian there."


def reference_word(run: Run) -> str:
    """Return the name of the images with which a run's rendered images are compared: "true" or "captured"."""
    return TRUE if run.has_truth else CAPTURED


def run_views(run: Run, *, title: str) -> Image.Image:
    """Return an image of a run's held-out views: true views, and below them the rendered views with their PSNR.

    In a world without ground truth, keyframes replace the held-out views.
    """
    arrays, word = run.pictures, reference_word(run)
    shown = detailed_views(arrays["true"])
    rows = [[to_image(arrays["true"][i]) for i in shown], [_rendered_tile(arrays, i) for i in shown]]
    return _with_note(
        tile_grid(
            rows,
            title=f"{title}: {'held-out views' if run.has_truth else 'keyframes'}",
            row_labels=[[word], ["rendered"]],
        ),
        BLACK_NOTE,
    )


def run_plan(
    arrays: Mapping[str, np.ndarray],
    trajectory: Mapping[str, np.ndarray],
    graph: Mapping[str, np.ndarray] | None,
    *,
    title: str,
) -> Image.Image:
    """Return an image of a run's plan (see `draw_plan`) with a legend and the camera height."""
    plan = draw_plan(arrays, trajectory)
    return _with_note(_with_legend(tile_grid([[plan]], title=title)), camera_height_text([(trajectory, graph)]))


def compare_views(runs: Sequence[Run], *, title: str) -> Image.Image:
    """Return an image with a row of true held-out views, and a row of the same views rendered from each run's map.

    All runs must be of the same scene and protocol.
    """
    first = runs[0].pictures
    shown = detailed_views(first["true"])
    rows = [[to_image(first["true"][i]) for i in shown]]
    labels = [[f"{reference_word(runs[0])} view"]]
    for run in runs:
        rows.append([_rendered_tile(run.pictures, i) for i in shown])
        mean = run.metrics["metrics"]["psnr"]
        labels.append(_run_label(run, run.job.title if mean is None else f"{mean:.2f} dB mean"))
    columns = [f"view {i + 1}" for i in shown]
    return _with_note(tile_grid(rows, title=title, row_labels=labels, column_labels=columns), BLACK_NOTE)


def compare_plans(runs: Sequence[Run], *, title: str) -> Image.Image:
    """Return an image with the plans of all runs next to each other, at one scale."""
    plans = [draw_plan(run.pictures, run.trajectory) for run in runs]
    labels = [f"{run.policy}: {_cost(run.metrics['metrics'])}" for run in runs]
    # The plan of a small scene can be narrower than its label.
    width = max(max(plan.width for plan in plans), *(text_width(label, 14) for label in labels))
    size = width, max(plan.height for plan in plans)
    tiles = [_on_page(plan, size) for plan in plans]
    page = _with_legend(tile_grid([tiles], title=title, column_labels=labels))
    return _with_note(page, camera_height_text([(run.trajectory, run.graph) for run in runs]))


def compare_strip(runs: Sequence[Run], *, title: str) -> Image.Image:
    """Return an image with a column for the true view, and one per run: its rendered view above its plan.

    The view is the `typical_view`.
    """
    index = typical_view(runs)
    truth = to_image(runs[0].pictures["true"][index])
    plans = [draw_plan(run.pictures, run.trajectory, truth.width) for run in runs]
    size = truth.width, truth.height + GAP + max(plan.height for plan in plans)
    columns, labels = [_on_page(truth, size)], [f"{reference_word(runs[0])} view"]
    for run, plan in zip(runs, plans):
        column = _on_page(_rendered_tile(run.pictures, index), size)
        column.paste(plan, ((truth.width - plan.width) // 2, truth.height + GAP))
        columns.append(column)
        ratio = run.metrics["metrics"]["completion_ratio"]
        labels.append(run.policy if ratio is None else f"{run.policy}, C.R. {ratio:.1f} %")
    page = _with_legend(tile_grid([columns], title=title, column_labels=labels, frames=False))
    return _with_note(page, f"{BLACK_NOTE} {camera_height_text([(run.trajectory, run.graph) for run in runs])}")


def typical_view(runs: Sequence[Run]) -> int:
    """Return the index of the view with the median PSNR among the `detailed_views`; PSNR is averaged over the runs.

    For an even number of views, the lower of the two middle views is taken.
    """
    psnr = np.mean([run.pictures["psnr"] for run in runs], axis=0)
    ordered = sorted(detailed_views(runs[0].pictures["true"]), key=lambda view: (psnr[view], view))
    return ordered[(len(ordered) - 1) // 2]


def detailed_views(true: np.ndarray) -> list[int]:  # [n, H, W, 3] uint8 -> indices, ascending
    """Return the indices of the four views whose true images have the largest mean gradient."""
    grey = true.astype(np.float32).mean(axis=-1)
    detail = np.abs(np.diff(grey, axis=1)).mean(axis=(1, 2)) + np.abs(np.diff(grey, axis=2)).mean(axis=(1, 2))
    return sorted(np.argsort(-detail, kind="stable")[:_SHOWN_VIEWS].tolist())


def _rendered_tile(arrays: Mapping[str, np.ndarray], index: int) -> Image.Image:
    tile = to_image(arrays["rendered"][index])
    corner_label(tile, f"{decimal(float(arrays['psnr'][index]), 1)} dB")
    return tile


def _run_label(run: Run, *more: str) -> list[str]:
    return [run.policy, f"seed {run.job.seed}", *more]


def _cost(metrics: Mapping[str, Any]) -> str:
    ratio = metrics["completion_ratio"]
    result = "" if ratio is None else f", C.R. {ratio:.1f} %"
    return f"{metrics['frames']} frames, {metrics['metres']:.1f} m{result}"


def _on_page(image: Image.Image, size: tuple[int, int]) -> Image.Image:
    page = Image.new("RGB", size, style.PAPER)
    page.paste(image, (0, 0))
    return page


def _with_note(page: Image.Image, note: str) -> Image.Image:
    width = max(page.width, 2 * MARGIN + text_width(note, 13))
    whole = _on_page(page, (width, page.height + 30))
    write(whole, (MARGIN, page.height + 4), note, size=13, fill=style.FAINT_INK)
    return whole


def _with_legend(page: Image.Image) -> Image.Image:
    key = legend()
    whole = _on_page(page, (max(page.width, key.width), page.height + key.height))
    whole.paste(key, (0, page.height))
    return whole
