"""Draw line charts and interval charts as SVG, in the page's light and dark colours.

The SVG of a chart has a sixth to a third of the size that matplotlib writes (docs/notebook/performance.md). Its data
attributes give the positions of the axes; the page uses them to show values at the pointer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.report.charts.svg import (
    Group,
    Part,
    drawing,
    label,
    marker,
    path,
    shape,
    simplified,
    stroke,
)
from activestructure_gym.evaluation.report.html import render
from activestructure_gym.evaluation.report.style import COLOURS, COLOURS_BY_NIGHT, hue, is_grey
from activestructure_gym.evaluation.report.tables.layout import Judgement

# Lengths are in units of the SVG's view box.
_SIZE = (460, 300)  # width and height of a line chart
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 18, 10, 44  # margins
_LABEL, _DIGIT = 24, 8  # width of the vertical axis label, and of a digit
_PANEL = (184, 104)  # width and height of one policy's panel
_LETTERS = 27  # largest number of characters of a policy's name in a chart
_BETWEEN = (12, 30)  # horizontal and vertical gap between panels
_PAD = 0.15  # space left and right of separate points, as a share of their range
_EMPTY = 0.2  # largest share of the horizontal axis that may be empty before the first curve
_ROUNDING = 1e-9  # relative difference below which two ends of an axis are one value
_DASHES = ("", "7 4", "9 3 2 3", "2 3", "9 3 2 3 2 3", "1 2", "14 4", "4 6")  # SVG dash pattern by policy index


@dataclass(frozen=True)
class Line:
    """Hold one policy's curve."""

    name: str  # of the policy
    index: int  # of the policy; selects colour, dash pattern and marker
    x: np.ndarray  # [G]
    y: np.ndarray  # [G]
    low: np.ndarray | None = None  # [G] lower end of the band; None: no band
    high: np.ndarray | None = None  # [G] upper end of the band


@dataclass(frozen=True)
class Bar:
    """Hold one policy's value and confidence interval."""

    name: str  # of the policy
    index: int  # of the policy; selects colour and marker
    value: float
    low: float | None  # lower end of the interval; None: no interval
    high: float | None  # upper end of the interval
    tone: Judgement = ""  # "good" or "bad" if the interval excludes 0, else empty


def line_chart(
    lines: Sequence[Line],
    *,
    title: str,
    x_label: str,
    y_label: str,
    y_includes: Sequence[float] = (),
    x_labels: Mapping[float, str] | None = None,
) -> Markup:
    """Return a chart of ``lines`` with their bands as SVG, with labelled axes.

    The vertical axis includes all values in ``y_includes``. The horizontal axis begins at 0, or near the first point if
    more than a fifth of the axis would be empty. ``x_labels`` are the labels of its ticks by position, for lines whose
    points are separate: every point then has a marker and a bar from its low to its high end.
    """
    width, height = _SIZE
    right = max((float(line.x[-1]) for line in lines), default=1.0) or 1.0
    first = min((float(line.x[0]) for line in lines), default=0.0)
    begin = 0.0 if first <= _EMPTY * right else max(tick for tick in ticks(0.0, right, 20) if tick < first)
    bottom, top = value_range(lines, y_includes)
    x_ticks = [tick for tick in ticks(begin, right) if begin <= tick <= right * (1 + 1e-9)]
    texts = {tick: tick_text(tick, x_ticks) for tick in x_ticks}
    if x_labels is not None:
        texts = dict(x_labels)
        pad = _PAD * (max(texts) - min(texts) or 1.0)
        begin, right = min(texts) - pad, max(texts) + pad
    y_ticks = ticks(bottom, top)
    left = max(_LEFT, _LABEL + _DIGIT * max(len(tick_text(tick, y_ticks)) for tick in y_ticks))
    x_range = (begin, right)
    y_range = (min(y_ticks[0], bottom), max(y_ticks[-1], top))

    def x_of(value: float) -> float:
        return left + (value - x_range[0]) / (x_range[1] - x_range[0]) * (width - left - _RIGHT)

    def y_of(value: float) -> float:
        return height - _BOTTOM - (value - y_range[0]) / (y_range[1] - y_range[0]) * (height - _TOP - _BOTTOM)

    parts: list[Part] = []
    for tick in y_ticks:
        parts.append(stroke("grid", left, y_of(tick), width - _RIGHT, y_of(tick)))
        parts.append(label(tick_text(tick, y_ticks), left - 7, y_of(tick) + 4, "end"))
    for tick, text in texts.items():
        parts.append(stroke("tick", x_of(tick), height - _BOTTOM, x_of(tick), height - _BOTTOM + 4))
        parts.append(label(text, x_of(tick), height - _BOTTOM + 17, "middle"))
    parts.append(stroke("axis", left, height - _BOTTOM, width - _RIGHT, height - _BOTTOM))
    parts.append(label(x_label, (left + width - _RIGHT) / 2, height - 8, "middle", "label"))
    middle = (_TOP + height - _BOTTOM) / 2
    parts.append(label(y_label, 12, middle, "middle", "label", transform=f"rotate(-90 12 {middle:g})"))
    groups = []
    for line in sorted(lines, key=lambda line: not is_grey(line.index)):  # coloured curves are drawn last
        places = [x_of(float(x)) for x in line.x]
        own: list[Part] = []
        grey = is_grey(line.index)
        if x_labels is not None:
            groups.append(Group({"class": hue(line.index)}, _separate(line, places, y_of), tooltip=line.name))
            continue
        if line.low is not None and line.high is not None and not grey:
            edge = [*zip(places, line.high), *reversed(list(zip(places, line.low)))]
            own.append(shape("band", path([(x, y_of(float(y))) for x, y in edge]) + "Z"))
        curve = [(x, y_of(float(y))) for x, y in zip(places, line.y)]
        if grey:
            own.append(shape("curve", path(simplified(curve))))
        else:
            own.append(shape("curve", path(curve), **{"stroke-dasharray": _DASHES[line.index] or None}))
            own.append(marker(line.index, *curve[-1]))
        groups.append(Group({"class": f"series s{line.index} {hue(line.index)}", "data-name": line.name}, own))
    data = {
        "data-frame": f"{left} {_TOP} {width - _RIGHT} {height - _BOTTOM}",
        "data-x": f"{x_range[0]:g} {x_range[1]:g}",
        "data-y": f"{y_range[0]:g} {y_range[1]:g}",
        "data-unit": f"{x_label}|{y_label}",
    }
    if x_labels is not None:
        data = {}  # no values between the points
    return drawing("chart", (width, height), title, axes=parts, groups=groups, data=data)


def _separate(line: Line, places: Sequence[float], y_of: Callable[[float], float]) -> list[Part]:
    """Return the elements of a line with a marker and a bar at every point; ``places`` are its positions in x."""
    heights = [y_of(float(y)) for y in line.y]
    dashes = None if is_grey(line.index) else _DASHES[line.index] or None
    parts: list[Part] = [shape("curve", path(list(zip(places, heights))), **{"stroke-dasharray": dashes})]
    if line.low is not None and line.high is not None:
        ends = zip(places, line.low, line.high)
        parts += [stroke("interval", x, y_of(float(low)), x, y_of(float(high))) for x, low, high in ends]
    return parts + [marker(line.index, x, y) for x, y in zip(places, heights)]


def value_range(lines: Sequence[Line], further: Sequence[float] = ()) -> tuple[float, float]:
    """Return the lowest and the highest of all values of the lines, their bands, and ``further``."""
    drawn = [values for line in lines for values in (line.y, line.low, line.high) if values is not None]
    values = np.concatenate([*drawn, np.asarray(further, np.float64)])
    if not len(values):
        return 0.0, 0.0
    return float(values.min()), float(values.max())


def panel_chart(lines: Sequence[Line], *, title: str, x_label: str, y_label: str, columns: int = 5) -> Markup:
    """Return a chart with one panel per policy: its curve and band, in front of all policies' curves in grey.

    It is for more policies than there are colours. All panels have the same axes: 0 to the largest cost horizontally,
    and the range of all curves vertically. ``columns`` is the number of panels next to each other.
    """
    panel_width, panel_height = _PANEL
    columns = max(1, min(columns, len(lines)))
    rows = max(1, math.ceil(len(lines) / columns))
    width = _LEFT + columns * (panel_width + _BETWEEN[0]) - _BETWEEN[0] + _RIGHT
    height = rows * (panel_height + _BETWEEN[1]) + _BOTTOM
    right = max((float(line.x[-1]) for line in lines), default=1.0) or 1.0
    values = np.concatenate([line.y for line in lines] or [np.zeros(1)])
    x_ticks = [tick for tick in ticks(0.0, right, 3) if tick <= right * (1 + 1e-9)]
    y_ticks = ticks(float(values.min()), float(values.max()), 3)
    y_low, y_high = y_ticks[0], y_ticks[-1]

    def places(x: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:  # in the panel's units
        upwards = np.clip((y - y_low) / (y_high - y_low), 0.0, 1.0)
        return list(zip((x / right * panel_width).tolist(), ((1.0 - upwards) * panel_height).tolist()))

    others = "".join(path(places(line.x, line.y)) for line in lines)
    others_id = "others-" + "".join(letter if letter.isalnum() else "-" for letter in title)
    groups = []
    for number, line in enumerate(lines):
        column, row = number % columns, number // columns
        lowest = number + columns >= len(lines)  # whether no panel is below this one
        below: list[Part] = []
        for tick in y_ticks:
            y = panel_height * (1.0 - (tick - y_low) / (y_high - y_low))
            below.append(stroke("grid", 0.0, y, panel_width, y))
            if column == 0:
                below.append(label(tick_text(tick, y_ticks), -7, y + 4, "end"))
        if lowest:
            for tick in x_ticks:
                x = tick / right * panel_width
                # The first and last labels are aligned to the panel's edges, so they do not overlap other panels.
                anchor = "start" if x < 15 else "end" if x > panel_width - 15 else "middle"
                below.append(label(tick_text(tick, x_ticks), x, panel_height + 17, anchor))
        own: list[Part] = []
        if line.low is not None and line.high is not None:
            edge = [*places(line.x, line.high), *reversed(places(line.x, line.low))]
            own.append(shape("band", path(edge) + "Z"))
        own.append(shape("curve", path(places(line.x, line.y))))
        own.append(label(shortened(line.name, _LETTERS), 0, -6, "start", "label"))
        place = f"translate({_LEFT + column * (panel_width + _BETWEEN[0])} {20 + row * (panel_height + _BETWEEN[1])})"
        groups.append(Group({"class": f"panel {hue(line.index)}", "transform": place}, own, below))
    middle = height / 2
    labels = [
        label(x_label, (_LEFT + width - _RIGHT) / 2, height - 6, "middle", "label"),
        label(y_label, 12, middle, "middle", "label", transform=f"rotate(-90 12 {middle:g})"),
    ]
    shared = {"id": others_id, "d": others}
    return drawing("chart panels", (width, height), title, groups=groups, labels=labels, shared=shared)


def interval_chart(bars: Sequence[Bar], *, title: str, x_label: str) -> Markup:
    """Return a chart of ``bars`` as SVG: per policy a row with its value and confidence interval, and a line at 0."""
    letters = max((len(shortened(bar.name, _LETTERS)) for bar in bars), default=0)
    width, row, name_width = _SIZE[0], 26, max(132, 18 + 7 * letters)
    height = _TOP + row * len(bars) + _BOTTOM
    ends = [end for bar in bars for end in (bar.value, bar.low, bar.high) if end is not None]
    low, high = min([0.0, *ends]), max([0.0, *ends])
    pad = 0.06 * (high - low or 1.0)
    low, high = low - pad, high + pad
    x_ticks = [tick for tick in ticks(low, high) if low <= tick <= high]

    def x_of(value: float) -> float:
        return name_width + (value - low) / (high - low) * (width - name_width - _RIGHT)

    floor = height - _BOTTOM
    parts: list[Part] = []
    for tick in x_ticks:
        parts.append(stroke("grid", x_of(tick), _TOP, x_of(tick), floor))
        parts.append(label(tick_text(tick, x_ticks, signed=True), x_of(tick), floor + 17, "middle"))
    parts.append(stroke("zero", x_of(0.0), _TOP - 4, x_of(0.0), floor))
    parts.append(label(x_label, (name_width + width - _RIGHT) / 2, height - 8, "middle", "label"))
    groups = []
    for number, bar in enumerate(bars):
        y = _TOP + row * (number + 0.5)
        own: list[Part] = [label(shortened(bar.name, _LETTERS), name_width - 8, y + 4, "end")]
        if bar.low is not None and bar.high is not None:
            own.append(stroke("interval", x_of(bar.low), y, x_of(bar.high), y))
            own += [stroke("interval end", x_of(end), y - 5, x_of(end), y + 5) for end in (bar.low, bar.high)]
        own.append(marker(bar.index, x_of(bar.value), y))
        tooltip = f"{bar.name}: {bar.value:+.3g}"
        if bar.low is not None and bar.high is not None:
            tooltip += f", 95 % interval {bar.low:+.3g} to {bar.high:+.3g}"
        groups.append(Group({"class": f"row {bar.tone} {hue(bar.index)}"}, own, tooltip=tooltip))
    return drawing("chart intervals", (width, height), title, axes=parts, groups=groups)


def legend_marker(index: int) -> Markup:
    """Return the line and the marker of the policy with this index, for a legend."""
    line = shape("curve", "M1 7H33", **{"stroke-dasharray": _DASHES[index % len(_DASHES)] or None})
    return render("legend_mark.svg.j2", kind=f"key {hue(index)}", parts=[line, marker(index, 17, 7)])


def standalone(charts: Sequence[Sequence[Markup]], names: Sequence[str], *, title: str) -> str:
    """Return rows of charts as the text of one SVG file, with a title and a legend, for use outside the page.

    ``names`` are the policies in the order of their indices. All policies drawn in grey share one legend entry.
    """
    names, grey = names[: len(COLOURS)], len(names[len(COLOURS) :])
    placed, right, y = [], 0.0, 40.0
    for row in charts:
        sizes = [_size(chart) for chart in row]
        x = 0.0
        for chart, (width, height) in zip(row, sizes):
            placed.append(_placed(chart, x, y, width, height))
            x += width
        right, y = max(right, x), y + max(height for _, height in sizes)
    x, y, legend = 16.0, y + 8, []
    for index, name in enumerate(names):
        needed = 64 + 7.6 * len(name)
        if x > 16.0 and x + needed > right:
            x, y = 16.0, y + 22
        legend.append((_placed(legend_marker(index), x, y, 34, 14), label(name, x + 40, y + 11, "start")))
        x += needed
    if grey:
        x, y = 16.0, y + 22
        legend.append(
            (_placed(legend_marker(len(COLOURS)), x, y, 34, 14), label(f"{grey} others", x + 40, y + 11, "start"))
        )
    right, y = max(right, math.ceil(x)), y + 26 if names else y
    whole = render(
        "standalone.svg.j2",
        width=f"{right:g}",
        height=f"{y:g}",
        style=Markup(chart_style()),
        heading=[label(title, 12, 24, "start", "heading")],
        charts=placed,
        legend=legend,
    )
    return whole + "\n"


def _placed(chart: Markup, x: float, y: float, width: float, height: float) -> Markup:
    """Return ``chart`` as an inner ``svg`` element at the position (x, y) with a width and a height."""
    return Markup(f'<svg x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}"{chart[len("<svg") :]}')


def _size(chart: Markup) -> tuple[float, float]:
    """Return the width and height of a chart, read from its ``viewBox`` attribute."""
    _, _, width, height = chart.split('viewBox="', 1)[1].split('"', 1)[0].split()
    return float(width), float(height)


def chart_style() -> str:
    """Return the CSS of a chart outside the page: colours of text, axes and policies, in a light and a dark theme."""
    colours = "".join(f".p{i}{{--c:{colour}}}" for i, colour in enumerate(COLOURS))
    by_night = "".join(f".p{i}{{--c:{colour}}}" for i, colour in enumerate(COLOURS_BY_NIGHT))
    return (
        "svg{--ink:#212529;--faint:#6c757d;--hair:#dee2e6}"
        f"{colours}"
        ".rest{--c:var(--faint)}.series.rest .curve{stroke-width:1;opacity:.4}"
        "@media(prefers-color-scheme:dark){svg{--ink:#e6e9ec;--faint:#9aa4ad;--hair:#39414a}" + by_night + "}"
        "text{font:13px system-ui,sans-serif;fill:var(--faint)}.label,.heading{fill:var(--ink)}"
        ".heading{font-size:17px;font-weight:700}"
        ".grid{stroke:var(--hair)}.axis,.tick,.zero{stroke:var(--faint)}.curve{fill:none;stroke:var(--c);stroke-width:2.2}"
        ".others{fill:none;stroke:var(--faint);stroke-width:.7;opacity:.28}"
        ".band{fill:var(--c);opacity:.16}.mark{fill:var(--c)}.interval{stroke:var(--c);stroke-width:2.2}"
    )


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return about ``about`` tick positions that enclose [``low``, ``high``].

    Their step is 1, 2 or 5 times a power of ten. Ends that differ only by rounding count as one value.
    """
    span = high - low
    if not span > _ROUNDING * max(abs(low), abs(high)):
        span = abs(low) or 1.0
        low, high = low - 0.5 * span, high + 0.5 * span
    power = 10.0 ** math.floor(math.log10(span / about))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power * about >= span - 1e-12)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [number * step for number in range(first, last + 1)]


def tick_text(tick: float, among: Sequence[float], *, signed: bool = False) -> str:
    """Format ``tick`` with the number of decimals that the step of the ticks ``among`` needs.

    ``signed`` adds a plus sign to positive numbers.
    """
    step = among[1] - among[0] if len(among) > 1 else abs(tick) or 1.0
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    text = f"{tick:+.{digits}f}" if signed and round(tick, digits) else f"{abs(tick) if not tick else tick:.{digits}f}"
    return text.replace("-", "−")


def shortened(text: str, letters: int) -> str:
    """Shorten ``text`` to ``letters`` characters by an ellipsis in its middle: related names differ at the end."""
    if len(text) <= letters:
        return text
    head = (letters - 1) // 2
    return f"{text[:head]}…{text[len(text) - (letters - 1 - head) :]}"
