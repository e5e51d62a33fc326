"""Legends of the page's pictures: label, shape and CSS background of every sign."""

from __future__ import annotations

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.floor_plan import FILLS


def _css(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


_WAY = ",".join(_css(style.path_colour(share / 4)) for share in range(5))
_CLASSES = (f"deficit < {style.DEFICIT_BOUNDS[0]:g}", *(f"{bound:g} +" for bound in style.DEFICIT_BOUNDS))
PLAN_KEY = (
    ("start", "disc", _css(style.START)), ("end", "square", _css(style.END)),
    ("path, first to last frame", "line", f"linear-gradient(90deg,{_WAY})"),
    ("keyframe, looking ahead", "dotted", _css(style.INK)),
    *((label, "box", _css(colour)) for label, colour in FILLS.items()),
)  # fmt: skip
TYPE_KEY = (
    ("structural plane", "box", _css(style.STRUCTURAL)), ("object plane", "box", _css(style.OBJECT)),
    ("facing down, as the ceiling", "outline", "transparent"), ("centroid", "disc", _css(style.STRUCTURAL)),
    ("spanning tree", "line", _css(style.TREE)), ("other edge", "hair", _css(style.EDGE)),
)  # fmt: skip
DEFICIT_KEY = (
    *((label, "box", _css(colour)) for label, colour in zip(_CLASSES, style.DEFICIT_COLOURS)),
    ("deficiency centre, by area", "ring", _css(style.PAPER)),
)
