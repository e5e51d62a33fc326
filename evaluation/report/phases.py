"""The timeline of an episode: phases, what the Plane Scene Graph lacks, and what the chosen views promised."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from activestructure_gym.evaluation.report import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Steps = Sequence[Mapping[str, Any]]  # the lines of steps.jsonl

_TINTS = ("#E3EEF6", "#FCEFD9", "#E6F2EA", "#F3E6EE")  # of the phases, in the order they appear
_KINDS = (("structural", style.STRUCTURAL, "-"), ("objects", style.OBJECT, "--"))
DISCOVERY = ("pixel", "hole_area", "unknown_volume", "unseen")  # the gain that stands for IG_px
# Terms of the gain, and factors in 0..1; a policy's other numbers are drawn among the terms in colours left over.
_TERMS = {
    **dict.fromkeys(DISCOVERY, ("#56B4E9", "-")),
    "structure": ("#0072B2", "--"),
    "deficiency": ("#D55E00", "-."),
    "visibility floor": ("#7F7F7F", ":"),
}
FACTORS = {"travel": ("#009E73", "-"), "discount": ("#CC79A7", "--"), "suppressed": ("#E69F00", "-.")}
SETTLED = "settled"  # the band of what is decided once nothing is left for the last phase to do
_MOST_DRAWN = 2000  # decisions of an episode; of more, an even choice: the picture has fewer pixels
_MOST_NUMBERED = 40  # changes of phase that are numbered and explained
_SHORT = 0.16  # share of the axis below which a phase's name is cut to its first word


@dataclass(frozen=True)
class Band:
    """Decisions in a row with the same phase."""

    phase: str
    start: float  # frames
    end: float
    reason: str | None = None  # why it began


def bands(steps: Steps) -> list[Band]:
    """The phases of an episode, what follows once its trace says ``settled`` as one more; empty without phases."""
    found: list[Band] = []
    for step, start in zip(steps, starts(steps)):
        trace = step.get("trace") or {}
        phase, reason = trace.get("phase"), trace.get("changed")
        if phase is None:
            continue
        if settled := trace.get("settled"):
            phase, reason = SETTLED, settled if isinstance(settled, str) else None
        if found and found[-1].phase == phase and found[-1].end == start:
            found[-1] = replace(found[-1], end=step["frames"])
        else:
            found.append(Band(str(phase), start, step["frames"], reason))
    return found


def drawn_decisions(count: int) -> list[int]:
    """Return the numbers of the decisions that are shown: all, or an even choice of them with the last one."""
    every = -(-count // _MOST_DRAWN) or 1
    return sorted({*range(0, count, every), *range(max(count - 1, 0), count)})


def drawn_steps(steps: Steps) -> Steps:
    """Return the decisions of `drawn_decisions`."""
    return [steps[number] for number in drawn_decisions(len(steps))]


def chosen_terms(steps: Steps) -> dict[str, np.ndarray]:  # [T] each, nan where a decision has no such number
    """The numbers behind every chosen view: the trace's ``chosen``, or those of a trace without one."""
    traces = [step.get("trace") or {} for step in steps]
    rows = [
        {name: value for name, value in (trace.get("chosen") or trace).items() if isinstance(value, float)}
        for trace in traces
    ]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def plot_phases(episodes: Sequence[tuple[str, Steps]], path: Path, *, title: str, gains: bool = True) -> None:
    """One block of panels per episode (its label and steps), all over the frames paid.

    Mean deficit and mean quality of structural and object planes, area of the deficiency centres; with ``gains`` also
    the terms and factors of the chosen views. Phases are bands, and the reasons of their changes stand below.
    """
    from matplotlib import rc_context

    with rc_context({"text.parse_math": False}):  # a dollar in a name is a dollar
        _plot(episodes, path, title, gains)


def _plot(episodes: Sequence[tuple[str, Steps]], path: Path, title: str, gains: bool) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    found = [bands(steps) for _, steps in episodes]
    episodes = [(label, drawn_steps(steps)) for label, steps in episodes]
    panels = [_panels(steps, gains) for _, steps in episodes]
    heights = [height for own in panels for _, height in own]
    figure = Figure(
        figsize=(10.5, 0.9 + sum(heights)), dpi=120, layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.05, hspace=0.0)
    )
    axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    everything = tuple(axes)
    end = max((step["frames"] for _, steps in episodes for step in steps), default=1)
    notes: list[str] = []
    for (label, steps), own, phases in zip(episodes, panels, found):
        block, axes = axes[: len(own)], axes[len(own) :]
        for axis, (draw, _) in zip(block, own):
            draw(axis, steps)
            _dress(axis)
            axis.set_xlim(0, end)
        draw_phases = _draw_bands if len(phases) <= _MOST_NUMBERED else _draw_many_bands
        notes += draw_phases(block, phases, end, first_number=len(notes) + 1)
        if len(episodes) > 1:
            block[0].set_title(label, loc="left", fontsize=11, fontweight="bold", pad=18)
    if not gains:  # one panel per episode: comparable at a glance
        top = max(axis.get_ylim()[1] for axis in everything)
        for axis in everything:
            axis.set_ylim(0, top)
    block[-1].set_xlabel("frames" + "".join(f"\n{note}" for note in notes), fontsize=10)
    figure.suptitle(title, fontsize=14, fontweight="bold", x=0.01, ha="left")
    with warnings.catch_warnings():  # a scene's name may hold letters the font lacks; the curves do not
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # lays out and draws once; `savefig` does so twice
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.save(path, "PNG", dpi=(figure.dpi, figure.dpi))


def _panels(steps: Steps, gains: bool) -> list[tuple[Any, float]]:  # what draws a panel, and its height in inches
    if not gains:
        return [(_deficit, 1.9)]
    panels: list[tuple[Any, float]] = [(_deficit, 2.0), (_quality, 1.4), (_holes, 1.1)]
    terms = chosen_terms(steps)
    if any(name not in FACTORS for name in terms):
        panels.append((_gain, 1.8))
    if any(name in FACTORS for name in terms):
        panels.append((_factors, 1.2))
    return panels


def starts(steps: Steps) -> list[float]:
    """Frames paid when each decision was made; the first frame belongs to none."""
    return [1, *(step["frames"] for step in steps[:-1])][: len(steps)]


def graph_series(steps: Steps, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Frames and values of one number of the graph at the end of each decision; nan, a gap, where there was none."""
    values = [(step.get("graph") or {}).get(name) for step in steps]
    frames = np.array([step["frames"] for step in steps], float)
    return frames, np.array([np.nan if value is None else value for value in values], float)


def _by_kind(axis: Axes, steps: Steps, quantity: str) -> None:
    """Means over structural planes, over objects and over all."""
    for kind, colour, dash in _KINDS:
        series = graph_series(steps, f"{quantity}_{kind}")
        axis.plot(*series, color=_hex(colour), linestyle=dash, marker="o", markersize=3, label=kind)
    axis.plot(*graph_series(steps, quantity), color=_hex(style.INK), linewidth=1, linestyle=":", label="all planes")
    axis.set_ylabel(f"mean {quantity}")


def _deficit(axis: Axes, steps: Steps) -> None:
    _by_kind(axis, steps, "deficit")
    axis.set_ylim(bottom=0)


def _quality(axis: Axes, steps: Steps) -> None:
    _by_kind(axis, steps, "quality")
    axis.set_ylim(top=1)


def _holes(axis: Axes, steps: Steps) -> None:
    x, area = graph_series(steps, "deficiency_area")
    axis.fill_between(x, area, color="#CED4DA", linewidth=0, label="deficiency\ncentres")
    axis.plot(x, area, color=_hex(style.FAINT_INK), linewidth=1.2)
    axis.set_ylabel("deficient [m²]")
    axis.set_ylim(bottom=0)


def _gain(axis: Axes, steps: Steps) -> None:
    terms, others = chosen_terms(steps), 0
    edges = np.array([*starts(steps), steps[-1]["frames"]], float)
    axis.axhline(0, color=_hex(style.FAINT_INK), linewidth=0.8)
    if "total" in terms:
        axis.stairs(terms["total"], edges, baseline=0, fill=True, color="#CED4DA", label="total")
    for name, values in terms.items():
        if name in FACTORS or name == "total":
            continue
        colour, dash = _TERMS.get(name, (style.colour(others + 3), style.DASHES[others % len(style.DASHES)]))
        others += name not in _TERMS
        axis.stairs(values, edges, baseline=None, color=colour, linestyle=dash, linewidth=1.5, label=name)
    axis.set_ylabel("chosen view's gain")


def _factors(axis: Axes, steps: Steps) -> None:
    terms = chosen_terms(steps)
    edges = np.array([*starts(steps), steps[-1]["frames"]], float)
    for name, (colour, dash) in FACTORS.items():
        if name in terms:
            axis.stairs(
                terms[name], edges, baseline=None, color=colour, linestyle=dash, linewidth=1.4,
                label="suppression" if name == "suppressed" else name,
            )  # fmt: skip
    axis.set_ylabel("factors")
    axis.set_ylim(0, 1.05)


def _draw_bands(block: Sequence[Axes], found: Sequence[Band], end: float, *, first_number: int) -> list[str]:
    """Tint the panels, name the phases above the first one, number the changes; returns the numbers' notes."""
    notes: list[str] = []
    order = list(dict.fromkeys(band.phase for band in found))
    for index, band in enumerate(found):
        for axis in block:
            axis.axvspan(band.start, band.end, color=_TINTS[order.index(band.phase) % len(_TINTS)], zorder=-2, lw=0)
        narrow = band.end - band.start < _SHORT * end
        block[0].annotate(
            band.phase.split()[0] if narrow else band.phase,
            ((band.start + band.end) / 2, 1.0), xycoords=("data", "axes fraction"),
            xytext=(0, 4), textcoords="offset points", ha="center", fontsize=10, fontweight="bold",
        )  # fmt: skip
        if index:
            number = first_number + len(notes)
            for axis in block:
                axis.axvline(band.start, color=_hex(style.INK), linewidth=1, linestyle=(0, (4, 3)), zorder=3)
            block[0].annotate(
                str(number), (band.start, 1.0), xycoords=("data", "axes fraction"), xytext=(0, -9),
                textcoords="offset points", ha="center", va="center", fontsize=8.5, color="white", fontweight="bold",
                bbox={"boxstyle": "circle,pad=0.25", "facecolor": _hex(style.INK), "edgecolor": "white"}, zorder=5,
            )  # fmt: skip
            reason = f": {band.reason}" if band.reason else ""
            notes.append(f"({number}) frame {band.start:g}, {band.phase}{reason}")
    return notes


def _draw_many_bands(block: Sequence[Axes], found: Sequence[Band], end: float, *, first_number: int) -> list[str]:
    """Tint the panels, name each phase above its longest band; return a note on how often it changes."""
    order = list(dict.fromkeys(band.phase for band in found))
    for phase, tint in zip(order, itertools.cycle(_TINTS)):
        own = [band for band in found if band.phase == phase]
        for axis in block:
            spans = [(band.start, band.end - band.start) for band in own]
            axis.broken_barh(spans, (0, 1), transform=axis.get_xaxis_transform(), color=tint, zorder=-2, lw=0)
        longest = max(own, key=lambda band: band.end - band.start)
        block[0].annotate(
            phase.split()[0], ((longest.start + longest.end) / 2, 1.0), xycoords=("data", "axes fraction"),
            xytext=(0, 4), textcoords="offset points", ha="center", fontsize=10, fontweight="bold",
        )  # fmt: skip
    return [f"the phase changes {len(found) - 1:,} times; each name stands above its longest stretch"]


def _dress(axis: Axes) -> None:
    axis.grid(color="#dee2e6", linewidth=0.7)
    axis.set_axisbelow(True)
    axis.yaxis.label.set_fontsize(10)
    axis.tick_params(labelsize=9, color="#adb5bd")
    axis.locator_params(axis="y", nbins=4)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axis.spines[side].set_color("#adb5bd")


def _hex(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
