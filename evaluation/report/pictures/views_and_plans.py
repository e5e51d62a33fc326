"""Compose rendered and true views, and plans with paths, of one run or of several."""

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
BLACK_NOTE = "Black: the map has no Gaussian there."


def run_views(arrays: Mapping[str, np.ndarray], *, title: str) -> Image.Image:
    """Return the true views above the run's rendered views, each with its PSNR."""
    shown = detailed_views(arrays["true"])
    rows = [[to_image(arrays["true"][i]) for i in shown], [_rendered_tile(arrays, i) for i in shown]]
    return _with_note(
        tile_grid(rows, title=f"{title}: held-out views", row_labels=[["true"], ["rendered"]]), BLACK_NOTE
    )


def run_plan(
    arrays: Mapping[str, np.ndarray],
    trajectory: Mapping[str, np.ndarray],
    graph: Mapping[str, np.ndarray] | None,
    *,
    title: str,
) -> Image.Image:
    """Return the plan: map from above, free space, path, keyframes and start."""
    plan = draw_plan(arrays, trajectory)
    return _with_note(_with_legend(tile_grid([[plan]], title=title)), camera_height_text([(trajectory, graph)]))


def compare_views(runs: Sequence[Run], *, title: str) -> Image.Image:
    """Return the same held-out views, true and as rendered by each run; all runs share scene and protocol."""
    first = runs[0].pictures
    shown = detailed_views(first["true"])
    rows = [[to_image(first["true"][i]) for i in shown]]
    labels = [["true view"]]
    for run in runs:
        rows.append([_rendered_tile(run.pictures, i) for i in shown])
        labels.append(_run_label(run, f"{run.metrics['metrics']['psnr']:.2f} dB mean"))
    columns = [f"view {i + 1}" for i in shown]
    return _with_note(tile_grid(rows, title=title, row_labels=labels, column_labels=columns), BLACK_NOTE)


def compare_plans(runs: Sequence[Run], *, title: str) -> Image.Image:
    """Return one plan per run, side by side, at one scale."""
    plans = [draw_plan(run.pictures, run.trajectory) for run in runs]
    labels = [f"{run.policy}: {_cost(run.metrics['metrics'])}" for run in runs]
    # A small scene's plan can be narrower than its label.
    width = max(max(plan.width for plan in plans), *(text_width(label, 14) for label in labels))
    size = width, max(plan.height for plan in plans)
    tiles = [_on_page(plan, size) for plan in plans]
    page = _with_legend(tile_grid([tiles], title=title, column_labels=labels))
    return _with_note(page, camera_height_text([(run.trajectory, run.graph) for run in runs]))


def compare_strip(runs: Sequence[Run], *, title: str) -> Image.Image:
    """Return the typical view, true and as rendered by each run, above the run's plan with its path."""
    index = typical_view(runs)
    truth = to_image(runs[0].pictures["true"][index])
    plans = [draw_plan(run.pictures, run.trajectory, truth.width) for run in runs]
    size = truth.width, truth.height + GAP + max(plan.height for plan in plans)
    columns, labels = [_on_page(truth, size)], ["true view"]
    for run, plan in zip(runs, plans):
        column = _on_page(_rendered_tile(run.pictures, index), size)
        column.paste(plan, ((truth.width - plan.width) // 2, truth.height + GAP))
        columns.append(column)
        labels.append(f"{run.policy}, C.R. {run.metrics['metrics']['completion_ratio']:.1f} %")
    page = _with_legend(tile_grid([columns], title=title, column_labels=labels, frames=False))
    return _with_note(page, f"{BLACK_NOTE} {camera_height_text([(run.trajectory, run.graph) for run in runs])}")


def typical_view(runs: Sequence[Run]) -> int:
    """Return the index of the `detailed_views` with the median PSNR, averaged over the runs.

    Of an even number of views it is the lower of the middle two.
    """
    psnr = np.mean([run.pictures["psnr"] for run in runs], axis=0)
    ordered = sorted(detailed_views(runs[0].pictures["true"]), key=lambda view: (psnr[view], view))
    return ordered[(len(ordered) - 1) // 2]


def detailed_views(true: np.ndarray) -> list[int]:  # [n, H, W, 3] uint8 -> indices, ascending
    """Return the four views with the largest mean gradient in the true image; rendered views do not matter."""
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
    return f"{metrics['frames']} frames, {metrics['metres']:.1f} m, C.R. {metrics['completion_ratio']:.1f} %"


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
