"""Draw the history of one run over its frames as SVG: deficit and quality of planes, and scores of chosen views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.report.charts.episode_series import (
    Steps,
    bands,
    chosen_terms,
    graph_series,
    starts,
)
from activestructure_gym.evaluation.report.charts.plots import tick_text, ticks
from activestructure_gym.evaluation.report.charts.svg import Group, Part, drawing, label, path, shape, stroke

# Lengths are in units of the SVG's view box.
_WIDTH, _LEFT, _RIGHT = 640, 52, 10  # width of the chart, and its left and right margins
_HEAD, _FOOT = 24, 34  # height of title and legend above each panel, and of the axis below the last panel
_LETTER, _SWATCH = 7.3, 26  # width of a letter, and of a line in the legend with its margins
DISCOVERY = ("pixel", "hole_area", "unknown_volume", "unseen")  # exploration terms, of which a policy has one
FACTORS = ("travel", "discount", "suppressed")  # factors of a score, in [0, 1]
# CSS classes of the colours of terms and factors. Other terms take the classes `_OTHER_HUES` in turn.
_HUES = dict.fromkeys(DISCOVERY, "p5")
_HUES |= {"structure": "p0", "deficiency": "p1", "visibility floor": "p6", "total": "rest"}
_HUES |= {"travel": "p2", "discount": "p3", "suppressed": "p4"}
_OTHER_HUES = ("p3", "p2", "p4", "p1", "p0")
_KINDS = {"structural": "p0", "objects": "p4", "all planes": "rest"}


@dataclass(frozen=True)
class _Panel:
    """Hold the series of one panel, which share a vertical axis."""

    title: str
    height: float
    series: Mapping[str, tuple[str, np.ndarray]]  # CSS class and values [T] by name; NaN if missing
    ends: tuple[float, ...] = ()  # values that the vertical axis must include
    held: bool = False  # whether a value is drawn as a horizontal line from the start to the end of its decision


def history_chart(steps: Steps) -> Markup | None:
    """Return a chart of panels below each other over the frames, or None if no decision has values to draw.

    The panels show the mean deficit and the mean quality of structural and object planes, the area of the deficiency
    centres (holes in planes), and the terms and factors of the chosen views' scores. Phases are shaded.
    """
    panels = [
        panel for panel in _panels(steps) if any(np.isfinite(values).any() for _, values in panel.series.values())
    ]
    if not panels:
        return None
    end = max(1.0, float(steps[-1]["frames"]))
    width = _WIDTH - _LEFT - _RIGHT
    starting, ending = np.array(starts(steps), float), np.array([step["frames"] for step in steps], float)
    groups, top = [], 0.0
    found = bands(steps)
    order = list(dict.fromkeys(band.phase for band in found))
    for panel in panels:
        parts: list[Part] = []
        for band in found:
            x, across = _LEFT + band.start / end * width, (band.end - band.start) / end * width
            kind = f"f{order.index(band.phase) % 4}"
            parts.append(shape(kind, f"M{x:.1f} {_HEAD}h{across:.1f}v{panel.height:g}h{-across:.1f}z"))
        values = np.concatenate([own for _, own in panel.series.values()])
        values = np.concatenate([values[np.isfinite(values)], panel.ends])
        y_ticks = ticks(float(values.min()), float(values.max()), 3)
        low, high = y_ticks[0], y_ticks[-1]

        def y_of(value: np.ndarray, low: float = low, high: float = high, height: float = panel.height) -> np.ndarray:
            return _HEAD + height * (1.0 - (value - low) / (high - low))

        for tick in y_ticks:
            level = float(y_of(np.array(tick)))
            parts.append(stroke("grid", _LEFT, level, _WIDTH - _RIGHT, level))
            parts.append(label(tick_text(tick, y_ticks), _LEFT - 6, level + 4, "end"))
        for kind, own in panel.series.values():
            places = np.stack([starting, ending], axis=1) if panel.held else ending[:, None]
            heights = np.repeat(y_of(own)[:, None], places.shape[1], axis=1)
            parts.append(shape(f"curve {kind}", _pieces(_LEFT + places / end * width, heights)))
        parts += _legend(panel)
        groups.append(Group({"transform": f"translate(0 {top:g})"}, parts))
        top += _HEAD + panel.height
    x_ticks = [tick for tick in ticks(0.0, end) if tick <= end * (1 + 1e-9)]
    labels: list[Part] = [label("frames", _LEFT + width / 2, top + _FOOT - 4, "middle", "label")]
    for tick in x_ticks:
        labels.append(label(tick_text(tick, x_ticks), _LEFT + tick / end * width, top + 16, "middle"))
    return drawing(
        "chart history", (_WIDTH, top + _FOOT), "history of the run over frames", groups=groups, labels=labels
    )


def _panels(steps: Steps) -> list[_Panel]:
    kinds = {"structural": "_structural", "objects": "_objects", "all planes": ""}

    def by_kind(quantity: str) -> dict[str, tuple[str, np.ndarray]]:
        return {name: (_KINDS[name], graph_series(steps, quantity + kind)[1]) for name, kind in kinds.items()}

    terms = chosen_terms(steps)
    others = iter(_OTHER_HUES * (1 + len(terms)))
    gains = {name: (_HUES.get(name) or next(others), values) for name, values in terms.items() if name not in FACTORS}
    factors = {name: (_HUES[name], values) for name, values in terms.items() if name in FACTORS}
    return [
        _Panel("mean deficit", 90, by_kind("deficit"), (0.0,)),
        _Panel("mean quality", 70, by_kind("quality"), (1.0,)),
        _Panel("deficient area [m²]", 60, {"": ("rest", graph_series(steps, "deficiency_area")[1])}, (0.0,)),
        _Panel("gain terms of the chosen view", 90, gains, (0.0,), held=True),
        _Panel("factors", 60, factors, (0.0, 1.0), held=True),
    ]


def _pieces(x: np.ndarray, y: np.ndarray) -> str:  # [T, n] each: n points per decision
    """Return SVG path data through T decisions with n points each, interrupted at decisions with a NaN."""
    whole = np.isfinite(y).all(axis=1)
    starting = np.flatnonzero(whole & ~np.concatenate([[False], whole[:-1]]))
    ending = np.flatnonzero(whole & ~np.concatenate([whole[1:], [False]])) + 1
    return "".join(
        path(list(zip(x[first:last].ravel().tolist(), y[first:last].ravel().tolist())))
        for first, last in zip(starting, ending)
    )


def _legend(panel: _Panel) -> list[Part]:
    parts: list[Part] = [label(panel.title, _LEFT, _HEAD - 8, "start", "label")]
    x = _LEFT + _LETTER * len(panel.title) + 16
    for name, (kind, _) in panel.series.items():
        if name:
            parts += [shape(f"curve {kind}", f"M{x:.1f} {_HEAD - 12}h18"), label(name, x + 23, _HEAD - 8, "start")]
            x += _SWATCH + _LETTER * len(name) + 8
    return parts
