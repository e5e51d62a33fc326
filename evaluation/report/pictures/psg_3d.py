"""Draw the Plane Scene Graph in 3D: planes coloured by type and by deficit, seen from two opposite corners."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageOps

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import write
from activestructure_gym.evaluation.report.pictures.plane_projection import (
    NO_PLANE,
    Projection,
    fit_projection,
    nearest_planes,
    outer_cells,
)
from activestructure_gym.evaluation.report.pictures.psg_legend import SMOOTH, draw_centres, draw_edges, draw_nodes
from activestructure_gym.planes.record import GraphArrays

_WIDTH, _HEIGHT = 620, 520  # largest size of a panel in pixels
_MARGIN = 14  # pixels around the planes
_CAPTION = 20  # height of the caption in pixels
_ELEVATION = 48.0  # degrees; elevation of the viewer, high enough to see over the walls into the rooms
_AZIMUTH = 28.0  # degrees between the viewer's direction and the normal of the scene's long side
_LIGHT = np.array([0.25, -0.45, 0.86])  # direction to the light, world frame
_SHADE = 0.2  # share by which a plane that faces away from the light is darker


def draw_planes_3d(arrays: GraphArrays, side: int = 0) -> tuple[Image.Image, Image.Image]:
    """Return two images: planes by type with the edges of the graph, and planes by deficit with deficiency centres.

    ``side`` 0 or 1 selects the corner of the viewer. Only planes that face the viewer are drawn, so the near walls and
    the ceiling are left out with their nodes, edges and deficiency centres. Occlusion is resolved per pixel.
    """
    if not len(arrays["ids"]):
        return _empty(), _empty()
    view = corner_view(arrays, side)
    owner, nearness = nearest_planes(arrays, view)
    borders = _borders(owner)
    shade = 1.0 - _SHADE * (0.5 - 0.5 * arrays["normals"] @ (_LIGHT / np.linalg.norm(_LIGHT)))
    types = np.array([style.plane_colour(bool(structural)) for structural in arrays["structural"]], float)
    types = 0.62 * types + 0.38 * 255.0  # lighter, so the nodes and edges stay visible
    deficits = np.array([style.deficit_colour(float(deficit)) for deficit in arrays["deficit"]], float)
    by_type = _painted(owner, borders, types * shade[:, None])
    facing = arrays["normals"] @ view.towards > 0
    centroids = view.pixels(arrays["centroids"])
    by_type = draw_edges(by_type, arrays, centroids, facing)
    draw_nodes(by_type, arrays, centroids, facing)
    by_deficit = _painted(owner, borders, deficits * (1.0 - 0.4 * (1.0 - shade[:, None])))
    holes = _facing_holes(arrays, view)
    places = view.pixels(holes["deficiency_centres"])
    draw_centres(by_deficit, holes, places, _hidden(holes, view, places, nearness))
    caption = f"seen from the {compass(view.towards)}"
    pair = _reduced(by_type, caption), _reduced(by_deficit, caption)
    # The lower part of the images is empty if all planes in it face away.
    bottom = min(max(_lowest_row(page) for page in pair) + _MARGIN, pair[0].height)
    by_type, by_deficit = (page.crop((0, 0, page.width, bottom)) for page in pair)
    return by_type, by_deficit


def compass(towards: np.ndarray) -> str:  # [3]
    """Return the compass direction of the viewer, given the direction to the viewer; north is +y of the world."""
    names = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
    return names[round(float(np.degrees(np.arctan2(towards[1], towards[0]))) / 45.0) % 8]


def corner_view(arrays: GraphArrays, side: int) -> Projection:
    """Return the parallel projection for a viewer at one of two opposite corners (``side`` 0 or 1).

    All planes fit a panel. The image is supersampled by `SMOOTH`.
    """
    points = outer_cells(arrays)
    extent = np.ptp(points, axis=0)
    azimuth = np.radians((-90.0 if extent[0] >= extent[1] else 0.0) + _AZIMUTH * (1 if extent[0] >= extent[1] else -1))
    azimuth += np.pi * side
    elevation = np.radians(_ELEVATION)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    flat = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    towards = np.cos(elevation) * flat + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    unit = fit_projection(points, right, towards, 1.0, 0)
    size = np.ptp(points @ unit.rows.T, axis=0)
    scale = min((_WIDTH - 2 * _MARGIN) / max(size[0], 1e-6), (_HEIGHT - 2 * _MARGIN) / max(size[1], 1e-6), 130.0)
    return fit_projection(points, right, towards, scale * SMOOTH, _MARGIN * SMOOTH)


def _facing_holes(arrays: GraphArrays, view: Projection) -> GraphArrays:
    """Return the arrays of the deficiency centres on planes that face the viewer."""
    facing = arrays["deficiency_normals"] @ view.towards > 0
    return {name: arrays[name][facing] for name in ("deficiency_centres", "deficiency_normals", "deficiency_areas")}


def _hidden(arrays: GraphArrays, view: Projection, places: np.ndarray, nearness: np.ndarray) -> np.ndarray:  # [D] bool
    """Return whether each of D deficiency centres, at the pixels ``places``, is occluded by a plane.

    ``nearness`` [H, W] is that of the nearest plane at each pixel, in metres.
    """
    x, y = np.clip(np.round(places).astype(int), 0, np.array(view.size) - 1).T
    return nearness[y, x] > view.nearness(arrays["deficiency_centres"]) + 0.1


def _borders(owner: np.ndarray) -> np.ndarray:  # [H, W] bool
    """Return the pixels at the borders of planes: another plane, or no plane, is less than a line width away.

    ``owner`` [H, W] is the index of the plane at each pixel.
    """
    border = np.zeros(owner.shape, bool)
    for step in range(1, SMOOTH):
        across, along = owner[:, step:] != owner[:, :-step], owner[step:] != owner[:-step]
        border[:, step:] |= across
        border[:, :-step] |= across
        border[step:] |= along
        border[:-step] |= along
    return border & (owner != NO_PLANE)


def _painted(owner: np.ndarray, borders: np.ndarray, colours: np.ndarray) -> Image.Image:
    table = np.vstack([colours, style.PAPER])  # the last row is for `NO_PLANE`, index -1
    plain, dark = (np.rint(t).astype(np.uint8) for t in (table, 0.55 * table + 0.45 * np.array(style.INK)))
    pixels = plain[owner]
    pixels[borders] = dark[owner[borders]]
    return Image.fromarray(pixels, "RGB")


def _reduced(picture: Image.Image, caption: str) -> Image.Image:
    small = picture.resize((picture.width // SMOOTH, picture.height // SMOOTH), Image.Resampling.LANCZOS)
    page = Image.new("RGB", (_WIDTH, small.height + _CAPTION), style.PAPER)
    page.paste(small, ((_WIDTH - small.width) // 2, _CAPTION))
    write(page, (0, 2), caption, size=13, fill=style.FAINT_INK)
    return page


def _lowest_row(page: Image.Image) -> int:
    box = ImageOps.invert(page).getbbox()
    return page.height if box is None else box[3]


def _empty() -> Image.Image:
    page = Image.new("RGB", (_WIDTH, 120), style.PAPER)
    write(page, (_WIDTH / 2, 60), "no plane found", fill=style.FAINT_INK, anchor="mm")
    return page
