"""Build the figure at the top of the page: one rendered view and one path per policy, for one scene and seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from markupsafe import Markup

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.html import render
from activestructure_gym.evaluation.report.page.data_uris import picture
from activestructure_gym.evaluation.report.page.html_legends import PLAN_LEGEND
from activestructure_gym.evaluation.report.page.run_links import replay_link
from activestructure_gym.evaluation.report.pictures.canvas import to_image
from activestructure_gym.evaluation.report.pictures.floor_plan import camera_height_text, draw_plan
from activestructure_gym.evaluation.report.pictures.views_and_plans import BLACK_NOTE, reference_word, typical_view
from activestructure_gym.evaluation.report.results import Results, opened
from activestructure_gym.evaluation.report.tables.columns import ratios_text
from activestructure_gym.evaluation.report.tables.layout import decimal


def header_figure(results: Results, anchor: str, directory: Path | None = None) -> Markup:
    """Return the figure as HTML for the first scene: the true view, and for each run its rendered view and its plan.

    The view is the `typical_view`. ``anchor`` is the HTML id of the scene's section, and ``directory`` the directory of
    the page.
    """
    candidates = results.shown(results.scenes[0])
    runs = opened(results.foremost(results.scenes[0]))
    index = typical_view(runs)
    where = f"{results.scenes[0]}, seed {runs[0].job.seed}"
    if len(runs) < len(candidates):
        where += f", the {len(runs)} of {len(candidates)} policies with the highest C.R., including the baseline"
    return render(
        "header_figure.html.j2",
        truth=picture(to_image(runs[0].pictures["true"][index]), f"the {reference_word(runs[0])} view"),
        word=reference_word(runs[0]),
        plan_legend=PLAN_LEGEND,
        tiles=[_tile(run, index, results.palette.index(run.policy), directory) for run in runs],
        where=where,
        black=BLACK_NOTE,
        camera_height=camera_height_text([(run.trajectory, run.graph) for run in runs]),
        anchor=anchor,
    )


def _tile(run: Run, index: int, number: int, directory: Path | None) -> dict[str, Any]:
    view, plan = to_image(run.pictures["rendered"][index]), draw_plan(run.pictures, run.trajectory)
    return {
        "index": number,
        "policy": run.policy,
        "replay": replay_link(run, directory),
        "ratios": ratios_text(run),
        "metrics": run.metrics["metrics"],
        "view": picture(view, f"the same view rendered from the map of {run.policy}"),
        "psnr": decimal(float(run.pictures["psnr"][index]), 1),
        "plan": picture(plan, f"map of {run.policy} from above, with its path"),
    }
