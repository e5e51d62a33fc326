"""Compose the figures of a run's Plane Scene Graph, with titles and legends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import Box, first_row_boxes, tile_grid
from activestructure_gym.evaluation.report.pictures.psg_3d import draw_planes_3d
from activestructure_gym.evaluation.report.pictures.psg_legend import deficit_legend, type_legend, with_legend
from activestructure_gym.evaluation.report.pictures.psg_plan import draw_planes_plan
from activestructure_gym.planes.record import GraphArrays

Pair = tuple[Image.Image, Image.Image]  # images of planes coloured by type, and by deficit


def run_planes_plan(
    arrays: GraphArrays, plan: Mapping[str, np.ndarray], *, title: str
) -> tuple[Image.Image, list[Box]]:
    """Return a page with the graph drawn over the plan, and the boxes of its two panels: by type and by deficit."""
    pair = draw_planes_plan(arrays, plan)
    page = _panels([pair], _counted(arrays), title=title, frames=True)
    return with_legend(page, type_legend(flat=True), deficit_legend()), first_row_boxes(pair)


def run_planes_3d(arrays: GraphArrays, *, title: str) -> tuple[Image.Image, list[Box]]:
    """Return a page with the graph in 3D, and the boxes of the two panels of its first row.

    The rows are views from two opposite corners; the columns are coloured by type and by deficit.
    """
    rows = [draw_planes_3d(arrays, side) for side in ((0, 1) if len(arrays["ids"]) else (0,))]
    page = with_legend(_panels(rows, _counted(arrays), title=title), type_legend(), deficit_legend(depth=True))
    return page, first_row_boxes(rows[0])


def _counted(arrays: GraphArrays) -> tuple[str, str]:
    """Return the labels of the two columns, with the numbers of planes and of deficiency centres."""
    structural, areas = int(arrays["structural"].sum()), arrays["deficiency_areas"]
    return (
        f"by type: {structural} structural planes, {len(arrays['ids']) - structural} object planes",
        f"by deficit: {len(areas)} deficiency centres, {areas.sum():.1f} m² in total",
    )


def _panels(rows: Sequence[Pair], labels: tuple[str, str], *, title: str, frames: bool = False) -> Image.Image:
    """Return a page with rows of two panels; each row has its own height, so the rows are composed separately.

    ``labels`` are the column labels of the first row.
    """
    pages = [
        tile_grid([row], title="" if index else title, column_labels=() if index else labels, frames=frames)
        for index, row in enumerate(rows)
    ]
    whole = Image.new("RGB", (max(page.width for page in pages), sum(page.height for page in pages)), style.PAPER)
    top = 0
    for page in pages:
        whole.paste(page, (0, top))
        top += page.height
    return whole
