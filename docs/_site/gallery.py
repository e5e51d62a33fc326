"""Make the gallery of policies: criterion, equation and features from docstrings, and curves of the benchmark."""

from __future__ import annotations

import csv
import inspect
import json
import re
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from statistics import fmean

from _site.reference import escaped
from activestructure_gym.features import FEATURES
from activestructure_gym.policies import POLICIES, Policy

DOCS = Path(__file__).parents[1]
CURVES = DOCS / "images" / "benchmark_curves.json"
RUNS = DOCS / "notebook" / "benchmark.csv"
SEEDS = ("0", "1", "2")  # seeds that every policy has played
SAME = {"activestructure-a": "pixel_only"}  # policy whose runs are byte by byte those of another policy, by name
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 340, 150, 34, 22  # size, left margin and lower margin of a chart in pixels
_MEASURE, _LOW, _HIGH = "observed", 20.0, 90.0  # metric and limits of the vertical axis in percent


def pages() -> dict[str, str]:
    """Return the gallery and one page per policy, by file name."""
    curves = json.loads(CURVES.read_text(encoding="utf-8"))
    names = sorted(POLICIES)
    texts = {f"policies/{name}.md": _page(name, curves) for name in names}
    last = {name: curves["policies"][name][_MEASURE][-1] for name in names if name in curves["policies"]}
    order = sorted(last, key=lambda name: -last[name]) + [name for name in names if name not in last]
    cards = "\n".join(_card(name, curves) for name in order)
    texts["policies/index.md"] = (
        "# Policies\n\n"
        f"All policies, sorted by the observed share of the surface in the benchmark ({curves['runs']} runs "
        f"each on {curves['scenes']} scenes, 300 frames; [benchmark.md](../../notebook/benchmark.md)). A curve is the "
        "observed share of the observable surface over frames. The other policies are in grey, and the one-step oracle "
        "with ground truth (`--references oracle`) is dashed. "
        "Results of the published planners are in [the notebook](../../notebook/planners.md).\n\n"
        f"{_table(names)}\n\n"
        f'```{{raw}} html\n{_behind(curves)}\n<div class="gallery">\n{cards}\n</div>\n```\n\n'
        "```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"
    )
    return texts


def _card(name: str, curves: dict) -> str:
    kind = POLICIES.get(name)
    behind = '<use href="#others"/>'
    chart = (
        _chart(name, curves, behind) if name in curves["policies"] else '<p class="none">no run in the benchmark</p>'
    )
    decides = _plain(kind.criterion or _first(kind))
    equation = f"<code>{_plain(found)}</code>" if (found := _equation(kind)) else ""
    return f'<a class="card" href="{name}.html"><strong>{name}</strong><span>{decides}</span>{equation}{chart}</a>'


def _page(name: str, curves: dict) -> str:
    kind = POLICIES.get(name)
    parts = [
        f"# `{name}`\n",
        f"Criterion: {kind.criterion or _first(kind)}. Travel term: {kind.travel_term}. Source: {kind.source}.\n",
    ]
    if name in curves["policies"]:
        row = " | ".join(f"{_benchmark(name, key):.1f}" for key in ("observed", "completion_ratio", "psnr"))
        parts.append(
            f"```{{raw}} html\n{_chart(name, curves, _others(curves))}\n```\n\n"
            "Observed share of the surface (%) over frames; the other policies in grey, the one-step oracle with "
            "ground truth dashed.\n\n"
            "| after 300 frames | observed (%) | C.R. of means (%) | PSNR (dB) |\n|---|---:|---:|---:|\n"
            f"| `{name}` | {row} |\n\n"
            f"Means over {curves['scenes']} scenes of means over seeds, {curves['runs']} runs; with intervals in "
            "[benchmark.md](../../notebook/benchmark.md).\n"
        )
    parts.append(_readme(kind))
    base, words = ("random", "chance") if name == "hole_area" else ("hole_area", "the area of holes")
    parts.append(
        f"```{{eval-rst}}\n.. autoclass:: {kind.__module__}.{kind.__name__}\n   :no-index:\n   :show-inheritance:\n"
        f"```\n\n```bash\nasg compare --policies {name},{base}    # against {words}\n"
        f"asg watch --policy {name}\n```\n"
    )
    if kind.required_features:
        parts.append("## What it reads of every view\n")
    for name in dict.fromkeys(FEATURES.owner(asked) for asked in kind.required_features):
        feature = FEATURES.get(name)
        units = ", ".join(dict.fromkeys(feature.units))
        columns = [f"`{column}`" for column in feature.columns if column]
        shape = f"[K, {len(feature.columns)}]: {', '.join(columns)}" if len(feature.columns) > 1 else "[K]"
        parts.append(f"### `{name}`\n\n{escaped(shape)}; unit: {escaped(units)}.\n")
        parts.append(escaped(inspect.cleandoc(feature.__doc__ or "")) + "\n")
    return "\n".join(parts)


def _benchmark(name: str, key: str) -> float:
    """Return a policy's value of the metric ``key`` in the table of benchmark.md.

    It is the mean over scenes of means over `SEEDS`.
    """
    by_scene = defaultdict(list)
    for run in _runs():
        if run["policy"] == SAME.get(name, name) and run["seed"] in SEEDS:
            by_scene[run["scene"]].append(float(run[key]))
    return fmean(map(fmean, by_scene.values()))


@cache
def _runs() -> list[dict[str, str]]:
    with RUNS.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _equation(kind: type[Policy]) -> str:
    """Return the first sentence with "=", argmax or argmin in the first paragraph of a policy's docstring, or ""."""
    first = " ".join(inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0].split())
    first = re.sub(r"^(Choose|Follow) ", "", first)
    sentences = re.split(r"(?<!Eq)(?<!Sec)(?<=[\w)\]])[.;](?=\s|$)| \(\[|, as ActiveGS", first)
    return next((one.strip(" .") for one in sentences if re.search(r" = |argm(ax|in)", one)), "")


def _table(names: Sequence[str]) -> str:
    rows = ["| policy | criterion | own travel term | source |", "|---|---|---|---|"]
    for name in names:
        kind = POLICIES.get(name)
        cells = (kind.criterion or _first(kind), kind.travel_term, kind.source)
        rows.append(f"| [`{name}`]({name}.md) | {' | '.join(map(escaped, cells))} |")
    return "\n".join(rows)


def _readme(kind: type[Policy]) -> str:
    """Return README.md in the folder of a policy without its heading, with adapted links; empty without the file."""
    page = Path(inspect.getfile(kind)).with_name("README.md") if kind.__module__.endswith(".policy") else None
    if page is None or not page.is_file():
        return ""
    _, _, text = page.read_text(encoding="utf-8").partition("\n")
    return text.replace("](../../docs/", "](../../").strip() + "\n"


def _first(kind: type[Policy]) -> str:
    return (kind.__doc__ or "").strip().partition("\n")[0].rstrip(".")


def _plain(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("`", "")


def _chart(name: str, curves: dict, behind: str) -> str:
    frames, mine = curves["frames"], curves["policies"][name][_MEASURE]
    ticks = "".join(
        f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH}" y1="{_y(value):.0f}" y2="{_y(value):.0f}"/>'
        f'<text x="{_LEFT - 4}" y="{_y(value) + 4:.0f}" text-anchor="end">{value:.0f}</text>'
        for value in (30.0, 50.0, 70.0, 90.0)
    )
    below = "".join(
        f'<text x="{_x(frame, frames):.0f}" y="{_HEIGHT - 6}" text-anchor="{place}">{frame}</text>'
        for frame, place in ((0, "start"), (100, "middle"), (200, "middle"), (300, "end"))
    )
    said = f"{name}: {mine[-1]:.0f} percent of the surface observed after {frames[-1]} frames"
    lines = f"{ticks}{below}{behind}{_line(frames, mine, 'mine')}"
    return f'<svg class="curve" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{said}">{lines}</svg>'


def _others(curves: dict) -> str:
    """Return the curves of all policies and of the oracle as SVG elements, for the background of a chart."""
    policies = [_line(curves["frames"], values[_MEASURE], "other") for values in curves["policies"].values()]
    return "".join(policies) + _line(curves["frames"], curves["references"]["oracle"][_MEASURE], "reference")


def _behind(curves: dict) -> str:
    """Return the background of all charts as an SVG with a definition "others", to which the charts refer."""
    lines = f'<defs><g id="others">{_others(curves)}</g></defs>'
    return f'<svg class="curve" width="0" height="0" aria-hidden="true">{lines}</svg>'


def _line(frames: Sequence[float], values: Sequence[float], kind: str) -> str:
    points = " ".join(
        f"{_x(frame, frames):.1f},{_y(value):.1f}" for frame, value in zip(frames, values) if value >= _LOW
    )
    return f'<polyline class="{kind}" points="{points}"/>'


def _x(frame: float, frames: Sequence[float]) -> float:
    return _LEFT + (_WIDTH - _LEFT) * frame / frames[-1]


def _y(value: float) -> float:
    return 4 + (_HEIGHT - _BOTTOM - 4) * (_HIGH - value) / (_HIGH - _LOW)
