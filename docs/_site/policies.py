"""Make the table of policies and a page per policy: rules from docstrings, results from the notebook's CSVs."""

from __future__ import annotations

import csv
import html
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
COSTS = DOCS / "notebook" / "decisions.csv"  # written by decisions.py
COST = "processor_s"
COLUMNS = {  # heading and explanation of each number in the table, by column of the CSVs
    "observed": ("observed (%)", "share of the surface that any keyframe saw"),
    "completion_ratio": ("C.R. (%)", "completion ratio: share of the surface with a Gaussian within 5 cm"),
    "psnr": ("PSNR (dB)", "image quality of held-out views"),
    COST: ("cost (s)", "processor seconds of one decision"),
}
FORMATS = {"observed": ".1f", "completion_ratio": ".1f", "psnr": ".2f", COST: ".2f"}
HOME = ("unknown_volume", "activestructure", "learned", "hole_area", "gs_planner", "active_gs", "fisherrf", "random")
SAME = {"activestructure-a": "pixel_only"}  # policy whose runs are byte by byte those of another policy, by name
_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 340, 150, 34, 22  # size, left margin and lower margin of a chart in pixels
_MEASURE, _LOW, _HIGH = "observed", 20.0, 90.0  # metric and limits of the vertical axis in percent


def pages() -> dict[str, str]:
    """Return the table of all policies, a page per policy, and the rows of the home page, by file name."""
    curves = json.loads(CURVES.read_text(encoding="utf-8"))
    names = sorted(POLICIES)
    texts = {f"policies/{name}.md": _page(name, curves) for name in names}
    measured = {name: number for name in names if (number := benchmark(name, "psnr")) is not None}
    order = sorted(measured, key=lambda name: -measured[name]) + [name for name in names if name not in measured]
    texts["policies/index.md"] = (
        "# Policies\n\n"
        f"Results are means over the {curves['scenes']} scenes of the [benchmark](../../notebook/benchmark.md), "
        "300 frames. C.R. (completion ratio) is the share of the surface with a Gaussian within 5 cm. "
        "Cost is the processor time of one decision with 256 candidates and 30,000 Gaussians, on one thread of a busy "
        "machine. Click a heading to sort. Tick policies to get the command that compares them.\n\n"
        f"```{{raw}} html\n{_table(order)}\n```\n\n"
        "```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"
    )
    texts["policies/short.txt"] = _short(sorted(HOME, key=lambda name: -(benchmark(name, "psnr", HOME) or 0.0)))
    return texts


def kind_of(policy: type[Policy]) -> str:
    """Return the origin of a policy: "learned", "ActiveStructure" (the paper), "ours" or "published"."""
    if ".learned." in policy.__module__:
        return "learned"
    if policy.source.startswith("ActiveStructure"):
        return "ActiveStructure"
    return "ours" if policy.source.startswith("this project") else "published"


def _table(order: Sequence[str]) -> str:
    """Return the table of policies as HTML; policies.js sorts and filters it and writes the command."""
    kinds = sorted({kind_of(POLICIES.get(name)) for name in order}, key=str.lower)
    columns = {"policy": "the name in commands", "rule and source": "", **dict(COLUMNS.values())}
    heads = "".join(f'<th scope="col" title="{words}">{head}</th>' for head, words in columns.items())
    rows = "\n".join(map(_row, order))
    choices = "".join(f"<option>{kind}</option>" for kind in kinds)
    sorts = "".join(f'<option value="{number}">{head}</option>' for number, head in enumerate(columns) if number != 1)
    return (
        '<div class="policies"><div class="tools">'
        '<input type="search" placeholder="filter" aria-label="Filter the policies">'
        f'<select class="kind" aria-label="Origin"><option value="">all origins</option>{choices}</select>'
        f'<select class="sort" aria-label="Sort by"><option value="">sort by</option>{sorts}</select>'
        '<span class="command"><code>asg compare --policies hole_area,random</code><button>copy</button></span></div>\n'
        f"<table><thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>\n"
        '<script src="../../_static/policies.js"></script>'
    )


def _row(name: str) -> str:
    kind = POLICIES.get(name)
    equation = f"<code>{_plain(found)}</code>" if (found := _equation(kind)) else ""
    numbers = "".join(
        f'<td data-label="{head}">{"" if (value := benchmark(name, key)) is None else format(value, FORMATS[key])}</td>'
        for key, (head, _) in COLUMNS.items()
    )
    return (
        f'<tr data-kind="{kind_of(kind)}"><td><label><input type="checkbox" value="{name}" aria-label="Compare {name}">'
        f'</label><a href="{name}.html">{name}</a></td><td>{_plain(kind.criterion or _first(kind))}{equation}'
        f"<small>{_plain(kind.source)}</small></td>{numbers}</tr>"
    )


def _short(order: Sequence[str]) -> str:
    """Return the table of the home page as Markdown."""
    lines = ["| policy | origin | observed (%) | C.R. (%) | PSNR (dB) |", "|---|---|---:|---:|---:|"]
    for name in order:
        numbers = " | ".join(
            f"{benchmark(name, key, HOME):{FORMATS[key]}}" for key in ("observed", "completion_ratio", "psnr")
        )
        lines.append(f"| [`{name}`](_made/policies/{name}.md) | {kind_of(POLICIES.get(name))} | {numbers} |")
    return "\n".join(lines) + "\n"


def _page(name: str, curves: dict) -> str:
    kind = POLICIES.get(name)
    parts = [
        f"# `{name}`\n",
        f"Criterion: {kind.criterion or _first(kind)}. Travel term: {kind.travel_term}. Source: {kind.source}.\n",
    ]
    if name in curves["policies"]:
        row = " | ".join(f"{benchmark(name, key):{FORMATS[key]}}" for key in COLUMNS)
        parts.append(
            f"```{{raw}} html\n{_chart(name, curves)}\n```\n\n"
            "Observed share of the surface (%) over frames; the other policies in grey, the one-step oracle with "
            "ground truth dashed.\n\n"
            f"| after 300 frames | {' | '.join(head for head, _ in COLUMNS.values())} |\n"
            f"|---|{'---:|' * len(COLUMNS)}\n| `{name}` | {row} |\n\n"
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


def benchmark(name: str, key: str, among: tuple[str, ...] = ()) -> float | None:
    """Return the mean of the metric ``key`` of a policy in benchmark.csv, or its cost in decisions.csv.

    A mean is over scenes of means over seeds, in the pairs that all policies of ``among`` have played, by default all
    of the file. None: the policy has no run there.
    """
    if key == COST:
        return next((float(row[key]) for row in _rows(COSTS) if row["policy"] == name), None)
    by_scene = defaultdict(list)
    for run in _rows(RUNS):
        if run["policy"] == SAME.get(name, name) and (run["scene"], run["seed"]) in _cells(among):
            by_scene[run["scene"]].append(float(run[key]))
    return fmean(map(fmean, by_scene.values())) if by_scene else None


@cache
def _cells(among: tuple[str, ...]) -> frozenset[tuple[str, str]]:
    by_policy = defaultdict(set)
    for run in _rows(RUNS):
        by_policy[run["policy"]].add((run["scene"], run["seed"]))
    return frozenset.intersection(*(frozenset(by_policy[name]) for name in among or by_policy))


@cache
def _rows(place: Path) -> list[dict[str, str]]:
    with place.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _equation(kind: type[Policy]) -> str:
    """Return the first sentence with "=", argmax or argmin in the first paragraph of a policy's docstring, or ""."""
    first = " ".join(inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0].split())
    first = re.sub(r"^(Choose|Follow) ", "", first)
    sentences = re.split(r"(?<!Eq)(?<!Sec)(?<=[\w)\]])[.;](?=\s|$)| \(\[|, as ActiveGS", first)
    return next((one.strip(" .") for one in sentences if re.search(r" = |argm(ax|in)", one)), "")


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
    return html.escape(text.replace("`", ""), quote=False)


def _chart(name: str, curves: dict) -> str:
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
    lines = f"{ticks}{below}{_others(curves)}{_line(frames, mine, 'mine')}"
    return f'<svg class="curve" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{said}">{lines}</svg>'


def _others(curves: dict) -> str:
    """Return the curves of all policies and of the oracle as SVG elements, for the background of a chart."""
    policies = [_line(curves["frames"], values[_MEASURE], "other") for values in curves["policies"].values()]
    return "".join(policies) + _line(curves["frames"], curves["references"]["oracle"][_MEASURE], "reference")


def _line(frames: Sequence[float], values: Sequence[float], kind: str) -> str:
    points = " ".join(
        f"{_x(frame, frames):.1f},{_y(value):.1f}" for frame, value in zip(frames, values) if value >= _LOW
    )
    return f'<polyline class="{kind}" points="{points}"/>'


def _x(frame: float, frames: Sequence[float]) -> float:
    return _LEFT + (_WIDTH - _LEFT) * frame / frames[-1]


def _y(value: float) -> float:
    return 4 + (_HEIGHT - _BOTTOM - 4) * (_HIGH - value) / (_HIGH - _LOW)
