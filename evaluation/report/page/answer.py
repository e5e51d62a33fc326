"""Build the page's answer: the policy that is best in most metrics, and per metric the best one and its lead."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.report.html import render
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables import verdicts
from activestructure_gym.evaluation.report.tables.layout import with_interval

_NAMED = 3  # largest number of policies that the sentence names
_SPELLED = {"C.R.": "completion ratio (C.R.)", "Depth": "Depth error"}  # of headings, where there is room for it


def answer(results: Results) -> Markup:
    """Return a sentence and one card per main metric as HTML."""
    leads = verdicts.leads(results)
    return render("answer.html.j2", text=answer_text(results, leads), cards=[_card(results, lead) for lead in leads])


def answer_text(results: Results, leads: Sequence[verdicts.Lead]) -> str:
    """Return sentences that name the policies with the best means, and how many of their leads are significant."""
    if not any(lead.runner_up for lead in leads):
        return ""
    missing = verdicts.partial(results)
    less = f" Without a run on every scene, so not compared: {', '.join(missing)}." if missing else ""
    return _compared(results, leads) + less


def _compared(results: Results, leads: Sequence[verdicts.Lead]) -> str:
    wins = Counter(lead.policy for lead in leads if not lead.tied).most_common()
    text = _winners(wins, len(leads))
    margins = [(lead.margin, lead.column) for lead in leads if lead.margin and lead.margin.difference.has_interval]
    if not margins:
        if not wins and verdicts.has_intervals(results):
            return text
        seeds = "One seed gives" if len(results.seeds) == 1 else "A single pair on a scene gives"
        return f"{text} {seeds} no intervals, so no lead is certain."
    sure = sum(verdicts.verdict(margin, column)[0].startswith("better") for margin, column in margins)
    pairs = min(margin.pairs for margin, _ in margins)
    few = f", at least {pairs} pairs" if pairs < verdicts.FEW else ""
    if not sure:
        nothing = f"No policy is clearly best: no lead is significant (95 %){few}."
        return nothing if len(wins) > _NAMED and wins[0][1] == wins[-1][1] else f"{nothing} {text}"
    if len(margins) == 1:
        return f"{text} The lead is significant (95 %){few}."
    if sure == len(margins):
        return f"{text} All {sure} leads are significant (95 %){few}."
    return f"{text} Of {len(margins)} leads, {sure} {'is' if sure == 1 else 'are'} significant (95 %){few}."


def _winners(wins: Sequence[tuple[str, int]], metrics: int) -> str:
    """Return a sentence on the policies and the numbers of metrics that each is best in, highest number first."""
    if not wins:
        return "The best policies are equal in all metrics."
    count, (policy, number) = pluralised(metrics, "metric"), wins[0]
    if len(wins) > 1 and wins[-1][1] == number:
        names = [policy for policy, _ in wins] if len(wins) <= _NAMED else [pluralised(len(wins), "policy", "policies")]
        return f"{' and '.join(filter(None, [', '.join(names[:-1]), names[-1]]))} are each best in {number} of {count}."
    more = sum(number for _, number in wins[_NAMED:])
    parts = [f"{policy} in {number}" for policy, number in wins[1:_NAMED]] + [f"others in {more}"] * bool(more)
    share = f"all {count}" if number == metrics else f"{number} of {count}"
    return f"{', '.join([f'{policy} is best in {share}', *parts])}."


def _card(results: Results, lead: verdicts.Lead) -> dict[str, Any]:
    column, ahead, words, tone = lead.column, "", "", ""
    if lead.margin is not None and lead.runner_up is not None:
        ahead = f"{with_interval(lead.margin.difference, column, signed=True).text} against {lead.runner_up}"
        words, tone = verdicts.verdict(lead.margin, column)
    return {
        "metric": _SPELLED.get(column.header, column.header),
        "meaning": column.meaning,
        "value": f"{lead.mean.value:.{column.digits}f}",
        "unit": column.unit,
        "winners": [(results.palette.index(policy), policy) for policy in (lead.policy, *lead.tied)],
        "shared": bool(lead.tied),
        "ahead": ahead,
        # The sentence above the cards defines "significant" and gives the number of pairs.
        "verdict": words.partition(",")[0].replace("no significant difference", "not significant"),
        "tone": tone,
    }
