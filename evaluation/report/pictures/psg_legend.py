"""Draw the nodes, edges, deficiency centres and legends of the Plane Scene Graph figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import MARGIN, text_width, write
from activestructure_gym.planes.record import GraphArrays

SMOOTH = 3  # supersampling factor: images are drawn this many times larger and then reduced
_NODE = 4.0  # radius of a centroid in pixels
_CENTRE = (2.5, 8.0)  # smallest and largest radius of a deficiency centre in pixels
_MANY = 80  # if there are more deficiency centres than this, they are drawn smaller
_TILE = 0.25  # m^2; area of a hole that is drawn with the largest radius: one full tile of a plane
_ROW = 24  # height of a row of the legend in pixels

Painter = Callable[[ImageDraw.ImageDraw, float, float], None]  # draws a symbol around a position


def draw_edges(
    picture: Image.Image,
    arrays: GraphArrays,
    places: np.ndarray,  # [N, 2] pixel positions of the centroids
    shown: np.ndarray,  # [N] bool: planes to draw
) -> Image.Image:
    """Draw the edges of the graph between shown planes over a supersampled image, and return the new image.

    Edges of the spanning tree are thick and dark.
    """
    layer = Image.new("RGBA", picture.size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    edges = arrays["edges"].reshape(-1, 2)
    kept = shown[edges].all(axis=1)
    thin, tree = (edges[kept & (arrays["edge_in_tree"] == kind)] for kind in (False, True))
    opacity = round(70 * min(1.0, (100 / max(len(thin), 1)) ** 0.5))  # of 255; many edges would hide the planes
    for i, j in thin:
        draw.line([*places[i], *places[j]], fill=(*style.EDGE, opacity), width=SMOOTH)
    for i, j in tree:
        draw.line([*places[i], *places[j]], fill=(*style.TREE, 170), width=round(1.4 * SMOOTH))
    return Image.alpha_composite(picture.convert("RGBA"), layer).convert("RGB")


def draw_nodes(picture: Image.Image, arrays: GraphArrays, places: np.ndarray, shown: np.ndarray) -> None:
    """Draw the centroids of the shown planes into ``picture``; the arguments are as in `draw_edges`."""
    draw = ImageDraw.Draw(picture)
    for k in np.flatnonzero(shown):
        colour = style.plane_colour(bool(arrays["structural"][k]))
        _disc(draw, places[k, 0], places[k, 1], _NODE * SMOOTH, colour, SMOOTH)


def draw_centres(
    picture: Image.Image,
    arrays: GraphArrays,
    places: np.ndarray,  # [D, 2] pixels
    hidden: np.ndarray,  # [D] bool: occluded, drawn as a dot
) -> None:
    """Draw deficiency centres as white discs; the area of a disc is proportional to the area of the hole."""
    draw = ImageDraw.Draw(picture)
    shrunk = min(1.0, max(0.35, (_MANY / max(len(places), 1)) ** 0.5))
    order = np.argsort(-arrays["deficiency_areas"] + 1e3 * ~hidden, kind="stable")  # occluded, then from large to small
    for k in order:
        if hidden[k]:
            _disc(draw, places[k, 0], places[k, 1], 1.6 * SMOOTH, style.FAINT_INK, 0)
        else:
            radius = shrunk * _CENTRE[1] * np.sqrt(min(1.0, arrays["deficiency_areas"][k] / _TILE))
            radius = max(shrunk * _CENTRE[0], radius) * SMOOTH
            _disc(draw, places[k, 0], places[k, 1], radius, style.PAPER, SMOOTH, ring=style.INK)


def type_legend(*, flat: bool = False) -> list[tuple[str, Painter]]:
    """Return the legend entries (label, painter) of plane types and the graph; ``flat`` adds planes facing down."""

    def outline(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
        draw.rectangle([x - 11, y - 7, x + 11, y + 7], outline=style.FAINT_INK)

    return [
        ("structural plane", _swatch(style.STRUCTURAL)),
        ("object plane", _swatch(style.OBJECT)),
        ("centroid", lambda draw, x, y: _disc(draw, x, y, _NODE, style.STRUCTURAL, 1)),
        ("spanning tree", _line(style.TREE, 2)),
        ("other edge", _line(style.EDGE, 1)),
        *([("facing down, such as ceilings", outline)] if flat else []),
    ]


def deficit_legend(*, depth: bool = False) -> list[tuple[str, Painter]]:
    """Return the legend entries (label, painter) of deficits and deficiency centres.

    ``depth`` adds occluded deficiency centres.
    """
    classes = [(label, _swatch(colour)) for label, colour in zip(style.DEFICIT_LABELS, style.DEFICIT_COLOURS)]

    def hole(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
        _disc(draw, x, y, 6, style.PAPER, 1, ring=style.INK)

    def dot(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
        _disc(draw, x, y, 2, style.FAINT_INK, 0)

    return [
        *classes,
        ("deficiency centre, size by area", hole),
        *([("occluded deficiency centre", dot)] if depth else []),
    ]


def with_legend(page: Image.Image, *rows: Sequence[tuple[str, Painter]]) -> Image.Image:
    """Return the page with a legend below it; each of ``rows`` is a line of entries (label, painter)."""
    widths = [[42 + text_width(label, 13) + 16 for label, _ in row] for row in rows]
    width = max(page.width, *(2 * MARGIN + sum(own) for own in widths))
    whole = Image.new("RGB", (width, page.height + _ROW * len(rows) + 8), style.PAPER)
    whole.paste(page, (0, 0))
    draw = ImageDraw.Draw(whole)
    for number, (row, own) in enumerate(zip(rows, widths)):
        x, y = MARGIN, page.height + _ROW * number + _ROW // 2 - 4
        for (label, paint), wide in zip(row, own):
            paint(draw, x + 17, y)
            write(whole, (x + 38, y), label, size=13, anchor="lm")
            x += wide
    return whole


def _swatch(colour: tuple[int, int, int]) -> Painter:
    return lambda draw, x, y: draw.rectangle([x - 11, y - 7, x + 11, y + 7], fill=colour, outline=style.FAINT_INK)


def _line(colour: tuple[int, int, int], width: int) -> Painter:
    return lambda draw, x, y: draw.line([x - 15, y, x + 15, y], fill=colour, width=width)


def _disc(
    draw: ImageDraw.ImageDraw,
    x: float,
    y: float,
    radius: float,
    fill: tuple[int, int, int],
    edge: int,
    *,
    ring: tuple[int, int, int] = style.PAPER,
) -> None:
    if edge:
        whole = radius + edge
        draw.ellipse([x - whole, y - whole, x + whole, y + whole], fill=ring)
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=fill)
