"""Show the decisions of a run in order: chosen view, terms of its score, cost and result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.charts.episode_series import (
    bands,
    chosen_terms,
    drawn_decisions,
    drawn_steps,
)
from activestructure_gym.evaluation.report.charts.history_chart import history_chart
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.page.run_links import run_links
from activestructure_gym.evaluation.report.tables.columns import ratios_text, value_of
from activestructure_gym.evaluation.report.tables.layout import Cell, Heading, Table, number

_DIGITS = 3  # decimals of terms
# Columns on the Plane Scene Graph: heading, field (None: the number of planes), and decimals.
_GRAPH = (("planes", None, 0), ("deficit", "deficit", 4), ("deficient (m²)", "deficiency_area", 1))


def run_trace(run: Run, directory: Path | None = None) -> tuple[str, Markup]:
    """Return a one-line summary of a run, and its details as HTML: phases, history, decisions, links to files.

    ``directory`` is the directory of the page, see `run_links`.
    """
    numbers = {key: value_of(run, key) for key in ("psnr", "metres", "collisions", "seconds")}
    parts = [f"{run.policy}, seed {run.job.seed}", ratios_text(run)]
    for key, form in (("psnr", "{:.2f} dB"), ("metres", "{:.1f} m")):
        if (value := numbers[key]) is not None:
            parts.append(form.format(value))
    parts.append(f"{len(run.steps)} decisions, {run.timing['total']:.0f} s")
    return " · ".join(parts), render(
        "decisions.html.j2",
        phases=phase_strip(run),
        history=history_chart(drawn_steps(run.steps)),
        table=html_table(trace_table(run), exact=False),
        job=run.job.hash,
        directory=run.directory.name,
        links=run_links(run, directory),
    )


def phase_strip(run: Run) -> Markup | None:
    """Return the phases of a run as a strip over the frames, with the reason of each; None without phases."""
    found = bands(drawn_steps(run.steps))
    if not found:
        return None
    return render(
        "phase_strip.html.j2",
        bands=found,
        order=list(dict.fromkeys(band.phase for band in found)),
        end=max(1, *(band.end for band in found)),
        notes=[band for band in found if band.reason],
    )


def trace_table(run: Run) -> Table:
    """Return a table with a row per decision of a run.

    Its columns are the cost so far, the phase, the position of the chosen view, the terms of its score, the score of
    the second-best view, and the state afterwards. Of a long episode, only the `drawn_decisions` are shown.
    """
    steps, terms = run.steps, chosen_terms(run.steps)
    phased = any((step.get("trace") or {}).get("phase") for step in steps)
    second = any((step.get("trace") or {}).get("runner_up") for step in steps)
    observed = any("observed" in (step.get("checkpoint") or {}) for step in steps)
    headings = [Heading("#"), Heading("frames"), Heading("path (m)"), Heading("s")]
    headings += [Heading("phase", numeric=False)] if phased else []
    headings += [Heading("to x, y, z (m)", numeric=False), Heading("path to it (m)"), Heading("candidates")]
    headings += [Heading(name) for name in terms]
    headings += [Heading("runner-up")] if second else []
    headings += [*(Heading(name) for name, _, _ in _GRAPH), Heading("Gaussians"), Heading("C.R. (%)")]
    headings += [Heading("observed (%)")] if observed else []
    headings.append(Heading("PSNR"))
    ended = run.timing.get("decisions", [])
    rows, shown = [], drawn_decisions(len(steps))
    for k in shown:
        step = steps[k]
        trace, view, graph = (step.get(name) or {} for name in ("trace", "view", "graph"))
        check = step.get("checkpoint") or {}
        row = [number(step.get("decision", k), 0), number(step.get("frames"), 0), number(step.get("metres"), 1)]
        row.append(number(ended[k] - (ended[k - 1] if k else 0.0) if k < len(ended) else None, 2))
        if phased:
            changed = trace.get("changed")
            row.append(Cell(f"{trace.get('phase') or ''}{' ←' if changed else ''}", note=changed or ""))
        row += [Cell(_position(view)), number(view.get("path_length"), 1), number(step.get("candidates"), 0)]
        row += [_term(values[k]) for values in terms.values()]
        if second:
            row.append(_term((trace.get("runner_up") or {}).get("total")))
        structural, objects = graph.get("structural"), graph.get("objects")
        planes = step.get("planes") if structural is None or objects is None else structural + objects
        for _, key, digits in _GRAPH:
            row.append(number(planes if key is None else graph.get(key), digits, ""))
        row.append(number(step.get("gaussians"), 0, ""))
        row.append(number(check.get("completion_ratio"), 1, ""))
        if observed:
            row.append(number(check.get("observed"), 1, ""))
        row.append(number(check.get("psnr"), 2, ""))
        rows.append(row)
    title = f"Decisions of {run.policy} on {run.scene}, seed {run.job.seed}"
    if len(shown) < len(steps):
        title += f" ({len(shown):,} of {len(steps):,}; all are in steps.jsonl)"
    return Table(f"trace-{run.job.name}", title, headings, rows)


def _position(view: Mapping[str, Any]) -> str:
    if not {"x", "y", "z"} <= view.keys():
        return ""
    return ", ".join(f"{view[axis]:.1f}" for axis in "xyz")


def _term(value: float | None) -> Cell:
    if value is None or value != value:  # NaN means that the decision has no such term
        return Cell("")
    return Cell(f"{value:.{_DIGITS}f}", float(value))
