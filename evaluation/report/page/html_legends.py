"""Define the legends of the page's images; an entry is a label, a shape and a CSS background."""

from __future__ import annotations

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.floor_plan import FILLS


def _css(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


_PATH = ",".join(_css(style.path_colour(share / 4)) for share in range(5))
PLAN_LEGEND = (
    ("start", "disc", _css(style.START)), ("end", "square", _css(style.END)),
    ("path, first to last frame", "line", f"linear-gradient(90deg,{_PATH})"),
    ("keyframe and view direction", "dotted", _css(style.INK)),
    *((label, "box", _css(colour)) for label, colour in FILLS.items()),
)  # fmt: skip
TYPE_LEGEND = (
    ("structural plane", "box", _css(style.STRUCTURAL)), ("object plane", "box", _css(style.OBJECT)),
    ("facing down, such as ceilings", "outline", "transparent"), ("centroid", "disc", _css(style.STRUCTURAL)),
    ("spanning tree", "line", _css(style.TREE)), ("other edge", "hair", _css(style.EDGE)),
)  # fmt: skip
DEFICIT_LEGEND = (
    *((label, "box", _css(colour)) for label, colour in zip(style.DEFICIT_LABELS, style.DEFICIT_COLOURS)),
    ("deficiency centre, size by area", "ring", _css(style.PAPER)),
)
