"""Build the figure at the top of the page: one rendered view and one path per policy, for one scene and seed.

Below the true view are the commands that repeat the runs, and the links to their replays.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from markupsafe import Markup

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.html import render
from activestructure_gym.evaluation.report.page.data_uris import picture
from activestructure_gym.evaluation.report.page.html_legends import PLAN_LEGEND
from activestructure_gym.evaluation.report.page.run_links import Link, relative_place, replay_link
from activestructure_gym.evaluation.report.pictures.canvas import to_image
from activestructure_gym.evaluation.report.pictures.floor_plan import camera_height_text, draw_plan
from activestructure_gym.evaluation.report.pictures.views_and_plans import BLACK_NOTE, reference_word, typical_view
from activestructure_gym.evaluation.report.results import Results, opened
from activestructure_gym.evaluation.report.tables.layout import decimal
from activestructure_gym.evaluation.report.text_filters import without_folders


def header_figure(results: Results, anchor: str, directory: Path | None = None) -> Markup:
    """Return the figure as HTML for the first scene: the true view, and for each run its rendered view and its plan.

    The view is the `typical_view`. ``anchor`` is the HTML id of the scene's section, and ``directory`` the directory of
    the page.
    """
    candidates = results.shown(results.scenes[0])
    runs = opened(results.foremost(results.scenes[0]))
    index, job = typical_view(runs), results.runs[0].job.conditions
    where = f"{results.scenes[0]}, seed {runs[0].job.seed}"
    if len(runs) < len(candidates):
        where += f", the {len(runs)} of {len(candidates)} policies with the highest C.R., including the baseline"
    unplayed = next((run for run in results.runs if replay_link(run, directory) is None), None)
    replays = [
        Link(f"{run.policy} on {run.scene}, seed {run.job.seed}", link.address)
        for run in results.runs
        if (link := replay_link(run, directory))
    ]
    commands = [command for source in results.sources for command in source.commands]
    return render(
        "header_figure.html.j2",
        commands=[without_folders(command) for command in commands],
        shortened=any(without_folders(command) != command for command in commands),
        conditions=f"{job.setup.capitalize()} setup, preset {job.preset}, "
        f"protocol{'s' * (len(results.protocols) > 1)} {' and '.join(results.protocols)}",
        replays=replays,
        without_replay=len(results.runs) - len(replays),
        unplayed=unplayed and (relative_place(unplayed, directory) or unplayed.directory.name),
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
        "view": picture(view, f"the same view rendered from the map of {run.policy}"),
        "psnr": decimal(float(run.pictures["psnr"][index]), 1),
        "plan": picture(plan, f"map of {run.policy} from above, with its path"),
    }
