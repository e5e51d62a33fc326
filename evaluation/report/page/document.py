"""Build the report as one HTML file that contains everything and needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.report.html import render
from activestructure_gym.evaluation.report.page.answer import answer
from activestructure_gym.evaluation.report.page.convergence_section import convergence_section
from activestructure_gym.evaluation.report.page.header_figure import header_figure
from activestructure_gym.evaluation.report.page.method_section import method_section
from activestructure_gym.evaluation.report.page.scene_section import scene_section
from activestructure_gym.evaluation.report.page.table_sections import (
    costs_section,
    differences_section,
    policies_section,
    published_section,
    quality_section,
    sweep_section,
)
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.style import COLOURS, COLOURS_BY_NIGHT
from activestructure_gym.evaluation.report.tables.columns import invalid_choices
from activestructure_gym.evaluation.report.tables.layout import Table

_ASSETS = Path(__file__).parents[1] / "assets"
_LINKED_SCENES = 4  # up to so many scenes have links in the page's navigation; more have one link to the first

# Content security policy: the page can load and send nothing, even if the name of a scene or policy contains a script.
CONTENT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


def html_page(results: Results, directory: Path | None = None, published: Sequence[Table] = ()) -> str:
    """Return the report page as HTML.

    ``directory`` is the directory that the page will be in; runs in it or next to it get links to their files. None
    makes no links. ``published`` are tables of published values.
    """
    anchors = [f"scene-{number}" for number in range(1, len(results.scenes) + 1)]
    names = list(dict.fromkeys(run.planner for run in results.runs))
    policies = _listed(names) if len(names) <= 6 else f"{len(names)} policies"
    title = f"{policies} on {pluralised(len(results.scenes), 'scene')}"
    title += f", sweep of {_listed(list(results.sweep))}" if results.sweep else ""
    sections = [
        _header(results, title, anchors[0], directory),
        policies_section(results),
        sweep_section(results),
        quality_section(results),
        differences_section(results),
        convergence_section(results),
        costs_section(results),
        published_section(published),
        *(scene_section(results, scene, anchor, directory) for scene, anchor in zip(results.scenes, anchors)),
        method_section(results),
    ]
    named = {"policies": "All policies", "sweep": "Sweep", "quality": "Quality", "against": "Differences"}
    named |= {
        "convergence": "Convergence",
        "costs": "Costs",
        "published": "Published values",
        **(dict(zip(anchors, results.scenes)) if len(anchors) <= _LINKED_SCENES else {anchors[0]: "Scenes"}),
        "how": "Method",
    }
    body = Markup().join(section for section in sections if section is not None)
    return render(
        "page.html.j2",
        policy=CONTENT_POLICY,
        title=title,
        style=Markup(_colours()) + _asset("report.css"),
        links=[(anchor, text) for anchor, text in named.items() if f' id="{anchor}"' in body],
        body=body,
        script=_asset("report.js"),
    )


def _asset(name: str) -> Markup:
    """Return the content of the file ``name`` in ``assets/`` as markup, which is not escaped."""
    return Markup((_ASSETS / name).read_text(encoding="utf-8"))


def _header(results: Results, title: str, anchor: str, directory: Path | None) -> Markup:
    facts = [
        pluralised(len(results.runs), "run"),
        pluralised(len(results.seeds), "seed"),
        *(f"{pluralised(len(values), 'value')} of {name}" for name, values in results.sweep.items()),
        f"{results.each(lambda config: str(config['frame_budget']))} frames each",
    ]
    return render(
        "header.html.j2",
        title=title,
        facts=facts,
        crossed={
            f"{run.scene} · {run.policy} · seed {run.job.seed}": n
            for run in results.runs
            if (n := run.metrics["metrics"]["collisions"])
        },
        invalid=invalid_choices(results.runs),
        missing=results.missing,
        answer=answer(results),
        figure=header_figure(results, anchor, directory),
    )


def _colours() -> str:
    day = "".join(f".p{i}{{--c:{colour}}}" for i, colour in enumerate(COLOURS))
    night = "".join(f".p{i}{{--c:{colour}}}" for i, colour in enumerate(COLOURS_BY_NIGHT))
    chosen = "".join(f'[data-theme="dark"] .p{i}{{--c:{colour}}}' for i, colour in enumerate(COLOURS_BY_NIGHT))
    guarded = night.replace(".p", ':root:not([data-theme="light"]) .p')
    return f"{day}@media(prefers-color-scheme:dark){{{guarded}}}{chosen}\n"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
