"""The Plane Scene Graph from above, over the plan of the run: walls as strokes, level surfaces as areas."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.plane_record import GraphArrays, seen_cells
from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.patches import Projection, cover, extremes, outlines
from activestructure_gym.evaluation.report.plan import draw_scale_bar, pixel_size, plan_base
from activestructure_gym.evaluation.report.planes_key import SMOOTH, draw_centres, draw_graph

_LEVEL = 0.8  # |z| of the normal from which a plane is an area of the plan and not a stroke
_FLOOR_M = 0.2  # level planes this near to the lowest are floor
_PIXELS_PER_METRE = 120
_LONGEST_SIDE = 600  # pixels, without the margin
_AROUND = 40  # pixels of the plan around the outermost planes; the scale bar stands there
_FADED = 0.75  # share of paper in the plan below
_FLOOR = 0.45  # opacity
_STROKES = {True: 6, False: 4}  # pixels, structural and object

Colour = tuple[int, int, int]


def draw_planes_plan(arrays: GraphArrays, plan: Mapping[str, np.ndarray]) -> tuple[Image.Image, Image.Image]:
    """By type with edges and tree, and by deficit with deficiency centres; ``plan`` as in `plan.plan_arrays`.

    Steep planes are strokes on the side they are seen from, so that both faces of a wall can be told apart. Level
    ones that face up are areas, the floor a faint one; those that face down, the ceiling among them, are outlines.
    """
    view = view_from_above(arrays, plan)
    types = [style.plane_colour(bool(structural)) for structural in arrays["structural"]]
    by_type = _drawn(arrays, plan, view, types.__getitem__)
    by_type = draw_graph(by_type, arrays, view.pixels(arrays["centroids"]))
    deficits = [style.deficit_colour(float(deficit)) for deficit in arrays["deficit"]]
    by_deficit = _drawn(arrays, plan, view, deficits.__getitem__)
    centres = arrays["deficiency_centres"]
    draw_centres(by_deficit, arrays, view.pixels(centres), np.zeros(len(centres), bool))
    for picture in (by_type, by_deficit):
        draw_scale_bar(picture, float(view.rows[0, 0]))
    small = view.size[0] // SMOOTH, view.size[1] // SMOOTH
    return by_type.resize(small, Image.Resampling.LANCZOS), by_deficit.resize(small, Image.Resampling.LANCZOS)


def view_from_above(arrays: GraphArrays, plan: Mapping[str, np.ndarray]) -> Projection:
    """The part of the plan that has planes, y up, drawn three times too large."""
    points = extremes(arrays)[:, :2]
    if not len(points):
        points = np.stack([plan["plan_corner"], plan["plan_corner"] + plan["plan_extent"]])
    low, high = points.min(axis=0), points.max(axis=0)
    scale = min(_PIXELS_PER_METRE, _LONGEST_SIDE / max(float((high - low).max()), 0.1)) * SMOOTH
    corner = low - _AROUND * SMOOTH / scale
    size = pixel_size(high + _AROUND * SMOOTH / scale - corner, scale)
    rows = np.array([[scale, 0.0, 0.0], [0.0, -scale, 0.0]])
    shift = np.array([-scale * corner[0], size[1] + scale * corner[1]])
    return Projection(rows, shift, np.array([0.0, 0.0, 1.0]), size)


def _ground(plan: Mapping[str, np.ndarray], view: Projection) -> Image.Image:
    """The plan without its colours, which would be taken for the planes', and faded."""
    base = plan_base(plan, float(view.rows[0, 0])).convert("L").convert("RGB")
    upper_left = np.array([plan["plan_corner"][0], plan["plan_corner"][1] + plan["plan_extent"][1], 0.0])
    page = Image.new("RGB", view.size, style.UNKNOWN)
    left, top = view.pixels(upper_left)
    page.paste(base, (round(left), round(top)))
    return Image.blend(page, Image.new("RGB", view.size, style.PAPER), _FADED)


def _drawn(
    arrays: GraphArrays, plan: Mapping[str, np.ndarray], view: Projection, colour: Callable[[int], Colour]
) -> Image.Image:
    picture = _ground(plan, view)
    rise, height = arrays["normals"][:, 2], arrays["centroids"][:, 2]
    up = [int(k) for k in np.argsort(height, kind="stable") if rise[k] >= _LEVEL]
    lowest = height[up[0]] if up else 0.0
    for plane in up:
        floor = height[plane] < lowest + _FLOOR_M
        _area(picture, arrays, plane, view, colour(plane), _FLOOR if floor else 0.85)
        _outline(picture, arrays, plane, view, colour(plane), 1 if floor else 2)
    for plane in np.flatnonzero(rise <= -_LEVEL).tolist():
        _outline(picture, arrays, plane, view, colour(plane), 1)
    # Structural strokes last: they are what the others hang on.
    for plane in sorted(np.flatnonzero(np.abs(rise) < _LEVEL).tolist(), key=lambda k: bool(arrays["structural"][k])):
        _stroke(picture, arrays, plane, view, colour(plane))
    return picture


def _area(
    picture: Image.Image, arrays: GraphArrays, plane: int, view: Projection, colour: Colour, opacity: float
) -> None:
    found = cover(arrays, plane, view)
    if found is not None:
        (rows, columns), shown, _ = found
        mask = Image.fromarray(np.where(shown, round(255 * opacity), 0).astype(np.uint8), "L")
        picture.paste(colour, (columns.start, rows.start), mask)


def _outline(
    picture: Image.Image, arrays: GraphArrays, plane: int, view: Projection, colour: Colour, width: int
) -> None:
    draw = ImageDraw.Draw(picture)
    for line in outlines(arrays, plane, view):
        draw.line([tuple(point) for point in [*line, line[0]]], fill=colour, width=width * SMOOTH, joint="curve")


def _stroke(picture: Image.Image, arrays: GraphArrays, plane: int, view: Projection, colour: Colour) -> None:
    draw = ImageDraw.Draw(picture)
    width = _STROKES[bool(arrays["structural"][plane])] * SMOOTH
    normal = arrays["normals"][plane]
    out = normal[:2] / np.linalg.norm(normal[:2])
    aside = np.array([out[0], -out[1]]) * width / 2  # y is down in the picture
    for start, end in stretches(arrays, plane):
        line = [tuple(view.pixels(point) + aside) for point in (start, end)]
        draw.line(line, fill=style.FAINT_INK, width=width + 2)
        draw.line(line, fill=colour, width=width)


def stretches(arrays: GraphArrays, plane: int) -> list[tuple[np.ndarray, np.ndarray]]:  # pairs of [3] metres
    """Where along the floor plan a steep plane has been seen at any height; gaps narrower than a cell are closed."""
    cell, axes, normal = float(arrays["cell"]), arrays["patch_axes"][plane], arrays["normals"][plane]
    rows, columns = np.nonzero(seen_cells(arrays, plane))
    cells = np.stack([rows, columns], axis=1) + 0.5
    along = np.array([-normal[1], normal[0], 0.0]) / np.linalg.norm(normal[:2])
    middle = arrays["centroids"][plane]
    offset = (arrays["patch_corners"][plane] - middle + cell * cells @ axes) @ along
    seen = np.unique(np.round(offset / cell).astype(np.int64))
    if not len(seen):
        return []
    breaks = np.flatnonzero(np.diff(seen) > 2)
    first, last = np.r_[0, breaks + 1], np.r_[breaks, len(seen) - 1]
    return [
        (middle + (seen[a] - 0.5) * cell * along, middle + (seen[b] + 0.5) * cell * along) for a, b in zip(first, last)
    ]
