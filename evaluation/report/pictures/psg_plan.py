"""Draw the Plane Scene Graph from above on the floor plan of a run: walls as lines, level planes as areas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.floor_plan import draw_scale_bar, pixel_size, plan_base
from activestructure_gym.evaluation.report.pictures.plane_projection import Projection, borders, outer_cells, silhouette
from activestructure_gym.evaluation.report.pictures.psg_legend import SMOOTH, draw_centres, draw_edges, draw_nodes
from activestructure_gym.planes.record import GraphArrays, seen_cells

_LEVEL = 0.8  # planes with at least this |z| of the unit normal are level; the others are steep
_FLOOR_M = 0.2  # metres; level planes up to this height above the lowest one belong to the floor
_PIXELS_PER_METRE = 120  # largest scale
_MAX_SIDE_PX = 600  # largest side of the part with planes in pixels, without the margin
_MAX_PLAN_SIDE_PX = 3000  # largest side of the whole plan in pixels; the whole plan is drawn, then cropped
_AROUND = 40  # margin in pixels; it contains the scale bar
_FADED = 0.75  # share of white that is blended into the plan below the planes
_FLOOR = 0.45  # opacity of floors, 0..1
_STROKES = {True: 6, False: 4}  # line width in pixels of structural (True) and object planes

Colour = tuple[int, int, int]


def draw_planes_plan(arrays: GraphArrays, plan: Mapping[str, np.ndarray]) -> tuple[Image.Image, Image.Image]:
    """Return two images: planes by type with the edges of the graph, and planes by deficit with deficiency centres.

    ``plan`` holds the arrays of `picture_record.plan_arrays`. Steep planes are lines, shifted to their observed side so
    that the two faces of a wall are separate. Level planes that face up are areas, which are faint for the floor.
    Planes that face down, such as ceilings, are outlines.
    """
    view = view_from_above(arrays, plan)
    ground, shapes = _ground(plan, view), _shapes(arrays, view)
    types = [style.plane_colour(bool(structural)) for structural in arrays["structural"]]
    # Edges of the graph are drawn after the areas, which would hide them, and before the walls, which stay visible.
    places, all_planes = view.pixels(arrays["centroids"]), np.ones(len(arrays["ids"]), bool)
    by_type = _drawn(ground, [shape for shape in shapes if not shape.stroke], types)
    by_type = draw_edges(by_type, arrays, places, all_planes)
    by_type = _drawn(by_type, [shape for shape in shapes if shape.stroke], types)
    draw_nodes(by_type, arrays, places, all_planes)
    deficits = [style.deficit_colour(float(deficit)) for deficit in arrays["deficit"]]
    by_deficit = _drawn(ground, shapes, deficits)
    centres = arrays["deficiency_centres"]
    draw_centres(by_deficit, arrays, view.pixels(centres), np.zeros(len(centres), bool))
    for picture in (by_type, by_deficit):
        draw_scale_bar(picture, float(view.rows[0, 0]))
    small = view.size[0] // SMOOTH, view.size[1] // SMOOTH
    return by_type.resize(small, Image.Resampling.LANCZOS), by_deficit.resize(small, Image.Resampling.LANCZOS)


def view_from_above(arrays: GraphArrays, plan: Mapping[str, np.ndarray]) -> Projection:
    """Return the projection from above onto the part of the plan with planes; y is up, supersampled by `SMOOTH`."""
    points = outer_cells(arrays)[:, :2]
    if not len(points):
        points = np.stack([plan["plan_corner"], plan["plan_corner"] + plan["plan_extent"]])
    low, high = points.min(axis=0), points.max(axis=0)
    whole = _MAX_PLAN_SIDE_PX / float(plan["plan_extent"].max())  # the planes may cover a small part of the plan
    scale = min(_PIXELS_PER_METRE, _MAX_SIDE_PX / max(float((high - low).max()), 0.1), whole) * SMOOTH
    corner = low - _AROUND * SMOOTH / scale
    size = pixel_size(high + _AROUND * SMOOTH / scale - corner, scale)
    rows = np.array([[scale, 0.0, 0.0], [0.0, -scale, 0.0]])
    shift = np.array([-scale * corner[0], size[1] + scale * corner[1]])
    return Projection(rows, shift, np.array([0.0, 0.0, 1.0]), size)


def _ground(plan: Mapping[str, np.ndarray], view: Projection) -> Image.Image:
    """Return the plan in faded grey as the background, since the planes have colours."""
    base = plan_base(plan, float(view.rows[0, 0])).convert("L").convert("RGB")
    upper_left = np.array([plan["plan_corner"][0], plan["plan_corner"][1] + plan["plan_extent"][1], 0.0])
    page = Image.new("RGB", view.size, style.UNKNOWN)
    left, top = view.pixels(upper_left)
    page.paste(base, (round(left), round(top)))
    return Image.blend(page, Image.new("RGB", view.size, style.PAPER), _FADED)


@dataclass(frozen=True)
class _Shape:
    """Hold the area and the lines that show one plane, without a colour."""

    plane: int  # index of the plane
    area: tuple[tuple[int, int], Image.Image] | None = None  # upper left pixel, and an image of opacities
    lines: Sequence[Sequence[tuple[float, ...]]] = ()  # polylines of pixel positions
    width: int = 1  # width of the lines in pixels
    stroke: bool = False  # whether the lines show a steep plane; then they have a grey edge


def _shapes(arrays: GraphArrays, view: Projection) -> list[_Shape]:
    """Return the shapes of all planes in drawing order."""
    rise, height = arrays["normals"][:, 2], arrays["centroids"][:, 2]
    up = [int(k) for k in np.argsort(height, kind="stable") if rise[k] >= _LEVEL]
    lowest = height[up[0]] if up else 0.0
    shapes = []
    for plane in up:
        floor = height[plane] < lowest + _FLOOR_M
        shapes.append(_level(arrays, plane, view, opacity=_FLOOR if floor else 0.85, width=1 if floor else 2))
    shapes += [_level(arrays, plane, view, opacity=0.0, width=1) for plane in np.flatnonzero(rise <= -_LEVEL).tolist()]
    # Structural planes are drawn last, so object planes do not hide them.
    steep = sorted(np.flatnonzero(np.abs(rise) < _LEVEL).tolist(), key=lambda k: bool(arrays["structural"][k]))
    return shapes + [_steep(arrays, plane, view) for plane in steep]


def _level(arrays: GraphArrays, plane: int, view: Projection, *, opacity: float, width: int) -> _Shape:
    found = silhouette(arrays, plane, view)
    if found is None:
        return _Shape(plane)
    (rows, columns), shown = found
    area = None
    if opacity:
        mask = Image.fromarray(shown.astype(np.uint8) * np.uint8(round(255 * opacity)), "L")
        area = (columns.start, rows.start), mask
    lines = [[tuple(point) for point in (*line.tolist(), line[0].tolist())] for line in borders(*found)]
    return _Shape(plane, area, lines, width * SMOOTH)


def _steep(arrays: GraphArrays, plane: int, view: Projection) -> _Shape:
    width = _STROKES[bool(arrays["structural"][plane])] * SMOOTH
    normal = arrays["normals"][plane]
    out = normal[:2] / np.linalg.norm(normal[:2])
    aside = np.array([out[0], -out[1]]) * width / 2  # y is down in the picture
    lines = [[tuple(view.pixels(point) + aside) for point in ends] for ends in observed_intervals(arrays, plane)]
    return _Shape(plane, None, lines, width, stroke=True)


def _drawn(ground: Image.Image, shapes: Sequence[_Shape], colours: Sequence[Colour]) -> Image.Image:
    picture = ground.copy()
    draw = ImageDraw.Draw(picture)
    for shape in shapes:
        colour = colours[shape.plane]
        if shape.area is not None:
            corner, mask = shape.area
            picture.paste(colour, corner, mask)
        for line in shape.lines:
            if shape.stroke:
                draw.line(line, fill=style.FAINT_INK, width=shape.width + 2)
            draw.line(line, fill=colour, width=shape.width, joint=None if shape.stroke else "curve")
    return picture


def observed_intervals(arrays: GraphArrays, plane: int) -> list[tuple[np.ndarray, np.ndarray]]:  # pairs of [3] metres
    """Return the horizontal intervals of a steep plane that are observed at any height, as pairs of world points.

    Gaps of one cell are closed.
    """
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
