"""Build the page's first section: best policy per metric, its lead, definitions, and the table of all policies."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.page.method_text import metric_definitions, missing_value_texts
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables import verdicts
from activestructure_gym.evaluation.report.tables.columns import aspects
from activestructure_gym.evaluation.report.tables.layout import with_interval
from activestructure_gym.evaluation.report.tables.paper import ablation_table


def glance_section(results: Results) -> Markup:
    """Return the first section as HTML: one card per main metric, definitions, and the table of all policies."""
    first, *others = [
        html_table(ablation_table(results, aspect), colours=results.palette) for aspect in aspects(results.runs)
    ]
    return render(
        "glance.html.j2",
        cards=[_card(results, lead) for lead in verdicts.leads(results)],
        collisions=sum(run.metrics["metrics"]["collisions"] or 0 for run in results.runs),
        runs=sum(run.has_truth for run in results.runs),
        caption=_cards_caption(results),
        definitions=metric_definitions(results),
        first=first,
        missing_value_texts=missing_value_texts(results),
        others=others,
    )


def _card(results: Results, lead: verdicts.Lead) -> dict[str, Any]:
    column, ahead, words, tone = lead.column, "", "", ""
    if lead.margin is not None and lead.runner_up is not None:
        found = lead.margin.difference
        value, _, interval = with_interval(found, column.digits, signed=True).text.partition(" ")
        ahead = f"{value} to {lead.runner_up} {interval}"
        words, tone = verdicts.verdict(lead.margin, column)
    return {
        "title": column.title,
        "value": f"{lead.mean.value:.{column.digits}f}",
        "unit": column.unit,
        "winners": [(results.palette.index(policy), policy) for policy in (lead.policy, *lead.tied)],
        "shared": bool(lead.tied),
        "ahead": ahead,
        "verdict": words,
        "tone": tone,
    }


def _cards_caption(results: Results) -> str:
    """Return sentences that explain the cards, and why there are no intervals if so."""
    several = len(results.scenes) > 1
    text = "Best policy of each metric" + (", by the mean over scenes" if several else "")
    if len(results.policies) > 1:
        text += ", and its paired difference to the second"
    if verdicts.has_intervals(results):
        return f"{text} with its 95 % interval."
    if len(results.policies) == 1:
        return f"{text}."
    seeds = "a single seed" if len(results.seeds) == 1 else "a single pair on a scene"
    return (
        f"{text}. With {seeds} there are no intervals, so these runs cannot show whether a difference is significant."
    )
