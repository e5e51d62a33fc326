"""The pages that show the Plane Scene Graph of one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import MARGIN, Box, first_row, tile_grid, write
from activestructure_gym.evaluation.report.pictures.psg_3d import draw_planes_3d
from activestructure_gym.evaluation.report.pictures.psg_legend import deficit_key, type_key, with_key
from activestructure_gym.evaluation.report.pictures.psg_plan import draw_planes_plan
from activestructure_gym.planes.record import GraphArrays

Pair = tuple[Image.Image, Image.Image]  # by type, by deficit


def run_planes_plan(
    arrays: GraphArrays, plan: Mapping[str, np.ndarray], *, title: str
) -> tuple[Image.Image, list[Box]]:
    """The graph over the plan: on the left by type, on the right by deficit; and where these two are."""
    pair = draw_planes_plan(arrays, plan)
    page = _panels([pair], [_counted(arrays)], title=title, frames=True)
    return with_key(page, type_key(flat=True), deficit_key()), first_row(pair)


def run_planes_3d(arrays: GraphArrays, *, title: str) -> tuple[Image.Image, list[Box]]:
    """The graph from two opposite corners, on the left by type, on the right by deficit; where the first two are."""
    rows = [draw_planes_3d(arrays, side) for side in ((0, 1) if len(arrays["ids"]) else (0,))]
    page = with_key(_panels(rows, [_counted(arrays)], title=title), type_key(), deficit_key(depth=True))
    return page, first_row(rows[0])


def _counted(arrays: GraphArrays) -> tuple[str, str]:
    """Titles of the two panels, with counts."""
    structural, areas = int(arrays["structural"].sum()), arrays["deficiency_areas"]
    return (
        f"by type: {structural} structural planes, {len(arrays['ids']) - structural} of objects",
        f"by deficit: {len(areas)} deficiency centres for {areas.sum():.1f} m²",
    )


def _panels(
    rows: Sequence[Pair],
    labels: Sequence[tuple[str, str]],  # above the columns of the first rows
    *,
    title: str,
    frames: bool = False,
) -> Image.Image:
    """Rows of two panels; rows may differ in height, so each is a page of its own."""
    pages = []
    for index, row in enumerate(rows):
        columns = labels[index] if index < len(labels) else ()
        pages.append(tile_grid([row], title=title if index == 0 else "", column_labels=columns, frames=frames))
    return _stacked(pages, "")


def _stacked(pages: Sequence[Image.Image], title: str) -> Image.Image:
    top = MARGIN + 30 if title else 0
    size = max(page.width for page in pages), top + sum(page.height for page in pages)
    whole = Image.new("RGB", size, style.PAPER)
    if title:
        write(whole, (MARGIN, MARGIN), title, size=22, bold=True)
    for page in pages:
        whole.paste(page, (0, top))
        top += page.height
    return whole
