"""The report as one HTML file that needs nothing else: no network, no other file, no library."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report import verdicts
from activestructure_gym.evaluation.report.charts import Bar, interval_chart, key_mark
from activestructure_gym.evaluation.report.columns import MAIN, aspects, measured
from activestructure_gym.evaluation.report.first_sight import first_sight
from activestructure_gym.evaluation.report.html import Html, element, folded, html_table, joined
from activestructure_gym.evaluation.report.layout import Cell, Heading, Table, with_interval
from activestructure_gym.evaluation.report.method_text import absences, definitions, meanings
from activestructure_gym.evaluation.report.paper_tables import ablation_table, quality_table
from activestructure_gym.evaluation.report.places import without_places
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.scene_section import chart_grid, policy_panels, scene_section
from activestructure_gym.evaluation.report.style import COLOURS, COLOURS_BY_NIGHT
from activestructure_gym.evaluation.statistics import interquartile_mean

_ASSETS = Path(__file__).with_name("assets")
# Whatever a scene's or a policy's name may hold, the page loads nothing and sends nothing.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def html_page(results: Results) -> str:
    """The whole page."""
    anchors = [f"scene-{number}" for number in range(1, len(results.scenes) + 1)]
    everyone = _listed(results.policies) if len(results.policies) <= 6 else f"{len(results.policies)} policies"
    title = f"{everyone} on {_counted(len(results.scenes), 'scene')}"
    sections = [
        _header(results, title, anchors[0]),
        _glance(results),
        _tables(results),
        _against(results),
        _convergence(results),
        _costs(results),
        *(scene_section(results, scene, anchor) for scene, anchor in zip(results.scenes, anchors)),
        _how(results),
    ]
    named = {"glance": "At a glance", "quality": "Quality", "against": "Differences", "convergence": "Convergence"}
    named |= {"costs": "Costs", **dict(zip(anchors, results.scenes)), "how": "How measured"}
    body = joined(*sections)
    links = [(anchor, text) for anchor, text in named.items() if f' id="{anchor}"' in body]
    navigation = element(
        "nav",
        element("div", *(element("a", text, href=f"#{anchor}") for anchor, text in links), class_="links"),
        element("button", "light / dark", type="button", id_="theme"),
        aria_label="sections",
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("title", f"ActiveStructure Gym: {title}"),
        element("link", rel="icon", href="data:,"),
        element("style", Html(_colours() + (_ASSETS / "report.css").read_text(encoding="utf-8"))),
    )
    script = element("script", Html((_ASSETS / "report.js").read_text(encoding="utf-8")))
    whole = element("body", navigation, element("main", body), _overlay(), script)
    return f'<!doctype html>\n<html lang="en">{head}{whole}</html>\n'


def _overlay() -> Html:
    """What a picture is shown in when it is enlarged; the script fills it."""
    close = element("button", "close", type="button", aria_label="close the enlarged picture")
    return element(
        "dialog", close, element("figure", element("figcaption", "")), id_="enlarged", aria_label="enlarged picture"
    )


def _header(results: Results, title: str, anchor: str) -> Html:
    first = results.runs[0]
    facts = [
        f"{_counted(len(results.runs), 'finished run')}: {_counted(len(results.scenes), 'scene')}, "
        f"{_counted(len(results.policies), 'policy', 'policies')}, {_counted(len(results.seeds), 'seed')}",
        f"preset {first.job.preset}, {first.config['configuration']['frame_budget']} frames per run",
        f"protocol {' and '.join(first.protocols)}",
    ]
    alarms: list[Html] = []
    crossed = {run.job.title: n for run in results.runs if (n := run.metrics["metrics"]["collisions"])}
    if crossed:
        items = (element("li", f"{name}: {_counted(n, 'step')}") for name, n in crossed.items())
        alarms.append(
            element(
                "div",
                element("strong", "Collisions. "),
                "These paths pass through the true mesh, which must not happen:",
                element("ul", *items),
                class_="alarm",
                role="alert",
            )  # fmt: skip
        )
    if results.missing:
        items = (
            element("li", element("b", without_places(name)), f": {without_places(why)}")
            for name, why in results.missing.items()
        )
        count = f"{_counted(len(results.missing), 'run')} missing. "
        alarms.append(
            element(
                "div",
                element("strong", count),
                "Not finished, and not counted:",
                element("ul", *items),
                class_="warning",
            )
        )
    return element(
        "header",
        element("p", "ActiveStructure Gym · report", class_="kicker"),
        element("h1", title),
        element("p", "; ".join(facts) + "."),
        *alarms,
        first_sight(results, anchor),
    )


def _glance(results: Results) -> Html:
    cards = []
    for lead in verdicts.leads(results):
        column = lead.column
        lines = [
            element("span", column.title, class_="metric"),
            element("strong", f"{lead.mean.value:.{column.digits}f}", element("small", f" {column.unit}")),
            *(element("span", _dot(results, p), p, class_="winner") for p in (lead.policy, *lead.level)),
        ]
        if lead.level:
            lines.append(element("span", "equal as printed", class_="badge"))
        if lead.ahead is not None and lead.runner_up is not None:
            found = lead.ahead.difference
            value, _, interval = with_interval(found, column.digits, signed=True).text.partition(" ")
            text = f"{value} to {lead.runner_up} {interval}"
            words, tone = verdicts.verdict(lead.ahead, column)
            lines.append(element("span", text))
            if words:
                lines.append(element("span", words, class_=f"badge {tone}"))
        cards.append(element("div", *lines, class_="card"))
    collisions = sum(run.metrics["metrics"]["collisions"] for run in results.runs)
    words, tone = ("must be 0", "alarm") if collisions else ("as it must be", "good")
    cards.append(
        element(
            "div", element("span", "collisions", class_="metric"), element("strong", str(collisions)),
            element("span", f"steps through the mesh in {_counted(len(results.runs), 'run')}"),
            element("span", words, class_=f"badge {tone}"),
            class_="card",
        )
    )  # fmt: skip
    first, *others = aspects(results.runs)
    terms = (element("div", element("dt", name), element("dd", f"{text}.")) for name, text in meanings(results).items())
    return element(
        "section",
        element("h2", "At a glance"),
        element("div", *cards, class_="cards"),
        element("p", _cards_say(results), class_="facts"),
        element("dl", *terms, class_="meanings"),
        html_table(ablation_table(results, first), colours=results.policies),
        _rank_key(),
        *(element("p", text, class_="facts") for text in absences(results)),
        *(html_table(ablation_table(results, other), colours=results.policies) for other in others),
        id_="glance",
    )


def _cards_say(results: Results) -> str:
    """What stands in the cards, and, said here once, why there may be no interval."""
    several = len(results.scenes) > 1
    text = "First of each metric" + (", by the mean over the scenes" if several else "")
    if len(results.policies) > 1:
        text += "; behind it the paired difference to the second"
    if verdicts.can_tell(results):
        return f"{text} with its 95 % interval."
    if len(results.policies) == 1:
        return f"{text}."
    seeds = "a single seed" if len(results.seeds) == 1 else "a single pair on a scene"
    return (
        f"{text}. With {seeds} there are no intervals: whether a difference is chance cannot be told from these runs."
    )


def _tables(results: Results) -> Html | None:
    """What the table at a glance does not say: of single scenes, and other statistics than the mean."""
    if len(results.scenes) == 1 and len(results.seeds) == 1:
        return None
    aggregates = html_table(verdicts.aggregate_table(results))
    if len(results.scenes) == 1:
        return element("section", element("h2", "Mean, median, interquartile mean"), aggregates, id_="quality")
    first, *others = (
        (aspect, html_table(quality_table(results, aspect, average=False), colours=results.policies))
        for aspect in aspects(results.runs)
    )
    return element(
        "section",
        element("h2", "Quality on every scene"),
        first[1],
        *(folded(f"Protocol {aspect.title}", table) for aspect, table in others),
        folded("Mean, median and interquartile mean", aggregates),
        id_="quality",
    )


def _against(results: Results) -> Html | None:
    """Nothing where one pair of runs is all there is: its difference stands at a glance."""
    table = verdicts.difference_table(results)
    if table is None or (len(results.scenes) == 1 and not verdicts.can_tell(results)):
        return None
    intervals = verdicts.can_tell(results)
    charts = []
    for column in measured(MAIN, results.runs):
        bars = [
            Bar(policy, results.policies.index(policy), d.value, d.low, d.high, verdicts.verdict(pair, column)[1])
            for policy, pair in verdicts.differences(results, column).items()
            if (d := pair.difference)
        ]
        if bars:
            title = f"{column.title}: difference to {results.baseline}"
            label = f"{column.header} [{column.unit}], better is {'left' if column.sign < 0 else 'right'}"
            caption = element("figcaption", element("b", title))
            charts.append(element("figure", caption, interval_chart(bars, title=title, label=label)))
    says = "Marks are mean differences, bars their 95 % intervals; where a bar stays clear of 0, chance is unlikely."
    matrices = [
        html_table(found, colours=results.policies)
        for column in measured(MAIN, results.runs)
        if (found := verdicts.improvement_table(results, column)) is not None
    ]
    return element(
        "section",
        element("h2", f"Differences to {results.baseline}"),
        element("p", says, class_="facts") if intervals else None,
        element("div", *charts, class_="charts") if intervals else None,
        html_table(table, colours=results.policies),
        folded("Probability of improvement, every policy against every other", *matrices) if intervals else None,
        id_="against",
    )


def _convergence(results: Results) -> Html:
    seeds, scenes = len(results.seeds), len(results.scenes)
    says = "Mean over all scenes and seeds" if scenes > 1 else "Mean over the seeds" if seeds > 1 else "One run each"
    says += ", band: 95 % bootstrap interval at every place" if seeds > 1 else "; no band with one seed"
    parts = [element("h2", "Convergence"), _legend(results), element("p", says + ".", class_="facts")]
    parts.append(chart_grid(results))
    if panels := policy_panels(results):
        parts.append(folded("A panel per policy, all others behind it", *panels, open_=True))
    if seeds > 1:
        parts.append(folded("The same as interquartile means", chart_grid(results, None, interquartile_mean)))
    parts.append(html_table(verdicts.area_table(results), colours=results.policies))
    return element("section", *parts, id_="convergence")


def _costs(results: Results) -> Html:
    return element(
        "section",
        element("h2", "Costs"),
        html_table(verdicts.cost_table(results), colours=results.policies),
        id_="costs",
    )


def _how(results: Results) -> Html:
    first = results.runs[0]
    configurations: dict[str, dict[str, str]] = {}
    for run in results.runs:
        for name, value in _flat(run.config["configuration"]):
            configurations.setdefault(name, {}).setdefault(without_places(str(value)), run.policy)
    rows = [
        [Cell(name), Cell(", ".join(values) if len(values) == 1 else "; ".join(f"{p}: {v}" for v, p in values.items()))]
        for name, values in configurations.items()
    ]
    configuration = Table(
        "configuration",
        "Configuration",
        _two("field", "value"),
        rows,
        "One row per field; where policies differ, one value each",
    )
    protocols = [
        Table(
            f"protocol-{name}",
            f"Protocol {name}",
            _two("parameter", "value"),
            [[Cell(key), Cell(without_places(str(value)))] for key, value in content["parameters"].items()],
        )
        for name, content in first.protocols.items()
    ]
    places = [
        [
            Cell(source.directory.name),
            Cell(without_places(source.command) or "single run"),
            Cell(str(source.workers or "")),
        ]
        for source in results.sources
    ]
    made = Table("sources", "Where the runs are", [*_two("directory", "command"), Heading("jobs at a time")], places)
    return element(
        "section",
        element("h2", "How it was measured"),
        *definitions(results),
        html_table(made),
        html_table(_machines(results.runs)),
        folded("Protocols", *map(html_table, protocols)),
        folded("Configuration", html_table(configuration)),
        folded("Versions", html_table(_versions(results.runs))),
        id_="how",
    )


def _machines(runs: Sequence[Run]) -> Table:
    found: dict[str, tuple[dict[str, Any], int]] = {}
    for run in runs:
        hardware = run.timing["hardware"]
        found[str(hardware)] = hardware, found.get(str(hardware), (hardware, 0))[1] + 1
    names = list(dict.fromkeys(name for hardware, _ in found.values() for name in hardware))
    rows = [
        [*(Cell(str(hardware.get(name, ""))) for name in names), Cell(str(count), count)]
        for hardware, count in found.values()
    ]
    caption = "Seconds of different machines cannot be compared" if len(rows) > 1 else ""
    return Table("hardware", "Hardware", [*(Heading(n, numeric=False) for n in names), Heading("runs")], rows, caption)


def _versions(runs: Sequence[Run]) -> Table:
    found: dict[str, dict[str, None]] = {}
    for run in runs:
        for name, version in run.config["versions"].items():
            found.setdefault(name, {})[version] = None
    rows = [
        [Cell(name), Cell(", ".join(versions), tone="alarm" if len(versions) > 1 else "")]
        for name, versions in found.items()
    ]
    return Table("versions", "Versions", _two("package", "version"), rows)


def _legend(results: Results) -> Html:
    """A button per policy that hides its curves everywhere."""
    buttons = [
        element(
            "button", key_mark(index), policy, type="button", class_="legend", data_series=f"s{index}",
            aria_pressed="true",
        )
        for index, policy in enumerate(results.policies)
    ]  # fmt: skip
    return element("div", *buttons, class_="legends", role="group", aria_label="policies shown in the curves")


def _rank_key() -> Html:
    ranks = (element("span", text, class_=f"r{rank}") for rank, text in ((1, "1st"), (2, "2nd"), (3, "3rd")))
    return element("p", *ranks, " of a column or scene; equal as printed shares a rank.", class_="ranks")


def _dot(results: Results, policy: str) -> Html:
    return element("i", class_=f"dot p{results.policies.index(policy) % len(COLOURS)}", aria_hidden="true")


def _colours() -> str:
    day = "".join(f".p{i}{{--c:{colour}}}" for i, colour in enumerate(COLOURS))
    night = "".join(f".p{i}{{--c:{colour}}}" for i, colour in enumerate(COLOURS_BY_NIGHT))
    chosen = "".join(f'[data-theme="dark"] .p{i}{{--c:{colour}}}' for i, colour in enumerate(COLOURS_BY_NIGHT))
    guarded = night.replace(".p", ':root:not([data-theme="light"]) .p')
    return f"{day}@media(prefers-color-scheme:dark){{{guarded}}}{chosen}\n"


def _flat(content: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in content.items():
        rows += _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else [(prefix + name, value)]
    return rows


def _two(first: str, second: str) -> list[Heading]:
    return [Heading(first, numeric=False), Heading(second, numeric=False)]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _counted(number: int, one: str, many: str | None = None) -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"
