"""Build the page's method section: definitions, commands, hardware, protocols, configuration and versions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from activestructure_gym.evaluation.archive.plugin_code import KEY as PLUGIN_CODE
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.page.method_text import definitions
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.layout import Cell, Heading, Table
from activestructure_gym.evaluation.report.text_filters import without_folders


def method_section(results: Results) -> Markup:
    """Return the method section as HTML: definitions, commands, hardware, protocols, configuration and versions."""
    return render(
        "method.html.j2",
        definitions=definitions(results),
        sources=html_table(_sources(results)),
        hardware=html_table(_machines(results.runs)),
        protocols=[html_table(table) for table in _protocols(results)],
        configuration=html_table(_configuration(results.runs)),
        versions=html_table(_versions(results.runs)),
    )


def _sources(results: Results) -> Table:
    rows = [
        [
            Cell(source.directory.name),
            Cell("; ".join(map(without_folders, source.commands)) or "single run"),
            Cell(str(source.workers or "")),
        ]
        for source in results.sources
    ]
    headings = [*_two("directory", "command"), Heading("parallel jobs")]
    return Table("sources", "Source directories", headings, rows)


def _protocols(results: Results) -> list[Table]:
    return [
        Table(
            f"protocol-{name}",
            f"Protocol {name}",
            _two("parameter", "value"),
            [[Cell(key), Cell(without_folders(str(value)))] for key, value in content["parameters"].items()],
        )
        for name, content in results.protocols.items()
    ]


def _configuration(runs: Sequence[Run]) -> Table:
    found: dict[str, dict[str, dict[str, None]]] = {}  # policies by field and value
    for run in runs:
        for name, value in _flat(run.config["configuration"]):
            found.setdefault(name, {}).setdefault(without_folders(str(value)), {})[run.policy] = None
    rows = []
    for name, values in found.items():
        texts = [f"{', '.join(policies)}: {value}" for value, policies in values.items()]
        rows.append([Cell(name), Cell("; ".join(values if len(values) == 1 else texts))])
    caption = "One row per field; different values with the policies that have them"
    return Table("configuration", "Configuration", _two("field", "value"), rows, caption)


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
    caption = "Seconds of different machines are not comparable" if len(rows) > 1 else ""
    return Table("hardware", "Hardware", [*(Heading(n, numeric=False) for n in names), Heading("runs")], rows, caption)


def _versions(runs: Sequence[Run]) -> Table:
    found: dict[str, dict[str, None]] = {}
    for run in runs:
        plugins = {name: checksum[:12] for name, checksum in run.config.get(PLUGIN_CODE, {}).items()}
        for name, version in (*run.config["versions"].items(), *plugins.items()):
            found.setdefault(name, {})[version] = None
    rows = [
        [Cell(name), Cell(", ".join(versions), tone="alarm" if len(versions) > 1 else "")]
        for name, versions in found.items()
    ]
    return Table("versions", "Versions", _two("package", "version"), rows)


def _flat(content: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in content.items():
        rows += _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else [(prefix + name, value)]
    return rows


def _two(first: str, second: str) -> list[Heading]:
    return [Heading(first, numeric=False), Heading(second, numeric=False)]
