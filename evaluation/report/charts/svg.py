"""Build the SVG elements of charts: paths, texts, and groups of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.report.html import render

_MARKERS = (  # path data of the markers by policy index, centred at (0, 0)
    "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0", "M-3.6 -3.6h7.2v7.2h-7.2z", "M0 -4.8L4.6 3.4H-4.6z", "M0 -5L5 0L0 5L-5 0z",
    "M0 4.8L4.6 -3.4H-4.6z", "M-1.6 -4.6h3.2v3h3v3.2h-3v3h-3.2v-3h-3v-3.2h3z",
    "M-4.6 -2.8L-2.8 -4.6L0 -1.8L2.8 -4.6L4.6 -2.8L1.8 0L4.6 2.8L2.8 4.6L0 1.8L-2.8 4.6L-4.6 2.8L-1.8 0z",
    "M0 -5.2L1.4 -1.7L5 -1.7L2.1 .7L3.1 4.4L0 2.2L-3.1 4.4L-2.1 .7L-5 -1.7L-1.4 -1.7z",
)  # fmt: skip


class Shape(NamedTuple):
    """Hold the attributes of an SVG ``path`` element."""

    attributes: dict[str, str | None]


class Text(NamedTuple):
    """Hold an SVG ``text`` element; ``anchor`` is its ``text-anchor``, and ``kind`` is its CSS class."""

    text: str
    x: float
    y: float
    anchor: str
    kind: str | None
    transform: str | None


Part = Shape | Text


class Group(NamedTuple):
    """Hold an SVG group, with the elements of one policy or of one panel."""

    attributes: dict[str, str]
    parts: Sequence[Part]
    below: Sequence[Part] = ()  # elements that are drawn first, below the path that all groups share
    tooltip: str = ""


def path(points: Sequence[tuple[float, float]]) -> str:
    """Return SVG path data for a polyline, rounded to tenths of a unit: the first point, then relative steps.

    Relative steps take half the bytes of absolute positions. They are differences of rounded positions, so rounding
    errors do not add up.
    """
    places = [(round(10 * x), round(10 * y)) for x, y in points]
    steps = [(x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in zip(places, places[1:])]
    return f"M{_tenths(*places[0])}" + ("l" + " ".join(_tenths(x, y) for x, y in steps) if steps else "")


def simplified(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Simplify a polyline by the algorithm of Douglas and Peucker, with a tolerance of 0.3 units."""
    kept = cv2.approxPolyDP(np.array(points, np.float32)[:, None], 0.3, closed=False)
    return [(float(x), float(y)) for x, y in kept[:, 0]]


def _tenths(x: int, y: int) -> str:
    """Format the pair (x / 10, y / 10) in the fewest characters that SVG accepts: ``.5-12`` for x = 5, y = -120."""
    first, second = (
        f"{number / 10:g}".replace("0.", ".") if abs(number) < 10 else f"{number / 10:g}" for number in (x, y)
    )
    return f"{first}{second}" if second.startswith("-") else f"{first} {second}"


def shape(kind: str, d: str, **attributes: str | None) -> Shape:
    """Return a path with the CSS class ``kind``, the path data ``d`` and further attributes."""
    return Shape({"class": kind, "d": d, **attributes})


def stroke(kind: str, x1: float, y1: float, x2: float, y2: float) -> Shape:
    """Return a straight line from (x1, y1) to (x2, y2) with the CSS class ``kind``."""
    return shape(kind, f"M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}")


def marker(index: int, x: float, y: float) -> Shape:
    """Return the marker of the policy with this index, centred at (x, y)."""
    return shape("mark", _MARKERS[index % len(_MARKERS)], transform=f"translate({x:.1f} {y:.1f})")


def label(text: str, x: float, y: float, anchor: str, kind: str | None = None, transform: str | None = None) -> Text:
    """Return a text at (x, y); ``anchor``, ``kind`` and ``transform`` are as in `Text`."""
    return Text(text, x, y, anchor, kind, transform)


def drawing(
    kind: str,
    size: tuple[float, float],
    title: str,
    *,
    axes: Sequence[Part] = (),
    groups: Sequence[Group] = (),
    labels: Sequence[Part] = (),
    data: Mapping[str, str] | None = None,
    shared: Mapping[str, str] | None = None,  # ``id`` and path data ``d`` of a path that every group draws
) -> Markup:
    """Return the SVG of a chart, which draws the axes first, then the groups, then the labels.

    ``kind`` is its CSS class, ``size`` its width and height, and ``data`` further attributes.
    """
    width, height = size
    return render(
        "chart.svg.j2", kind=kind, width=width, height=height, title=title, axes=axes, groups=groups, labels=labels,
        data=data or {}, shared=shared,
    )  # fmt: skip
