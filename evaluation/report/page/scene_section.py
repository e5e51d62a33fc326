"""Build the page's section of one scene: table, curves, views, plans, planes and the decisions of each run.

With many policies, only the policies of `Results.foremost` have images in full size; the others have thumbnails.
"""

from __future__ import annotations

import copy
from pathlib import Path

from markupsafe import Markup

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.page.convergence_section import chart_grid
from activestructure_gym.evaluation.report.page.decisions import run_trace
from activestructure_gym.evaluation.report.page.html_legends import DEFICIT_LEGEND, PLAN_LEGEND, TYPE_LEGEND
from activestructure_gym.evaluation.report.page.tiles import Tiles, plan_tile, planes_tile, views_strip
from activestructure_gym.evaluation.report.pictures.floor_plan import camera_height_text
from activestructure_gym.evaluation.report.pictures.views_and_plans import BLACK_NOTE
from activestructure_gym.evaluation.report.results import Results, opened
from activestructure_gym.evaluation.report.tables.columns import overview_columns
from activestructure_gym.evaluation.report.tables.overview import overview, table_rows
from activestructure_gym.evaluation.report.text_filters import without_folders


def scene_section(results: Results, scene: str, anchor: str, directory: Path | None = None) -> Markup:
    """Return the section of ``scene`` as HTML, without tables and curves that earlier sections show already.

    ``anchor`` is the HTML id of the section, and ``directory`` the directory of the page.
    """
    shown = opened(results.shown(scene))
    full = frozenset(run.policy for run in results.foremost(scene))
    tiles = Tiles(results.palette, full, directory)
    numbers = curves = None
    if len(results.scenes) > 1:
        # The quality section has the means already. This table adds the deviation over seeds and the costs.
        runs = results.of(None, scene)
        columns = overview_columns(runs)
        columns = columns if len(results.seeds) > 1 else [column for column in columns if column.best is None]
        table = overview(table_rows(runs), columns, name=anchor)
        numbers, curves = html_table(table, colours=results.palette), chart_grid(results, scene)
    views, plans = views_strip(shown, tiles), [plan_tile(run, tiles) for run in shown]
    graphs = [planes_tile(run, tiles) for run in shown if run.graph is not None]
    traces = [run_trace(copy.copy(run), directory) for policy in results.policies for run in results.of(policy, scene)]
    return render(
        "scene.html.j2",
        anchor=anchor,
        scene=scene,
        facts=scene_facts(shown[0]),
        numbers=numbers,
        curves=curves,
        seed_text=seed_text(results, scene),
        views=[row for row in views if row["name"] in full or row["index"] is None],
        more_views=[row for row in views if row["name"] not in full and row["index"] is not None],
        black_note=BLACK_NOTE,
        has_truth=shown[0].has_truth,
        plans=[plan for plan in plans if plan["policy"] in full],
        more_plans=[plan for plan in plans if plan["policy"] not in full],
        plan_legend=PLAN_LEGEND,
        camera_height=camera_height_text([(run.trajectory, run.graph) for run in shown]),
        graphs=[graph for graph in graphs if graph["pictures"]],
        more_graphs=[graph for graph in graphs if not graph["pictures"]],
        deficit_legend=DEFICIT_LEGEND,
        type_legend=TYPE_LEGEND,
        traces=traces,
    )


def seed_text(results: Results, scene: str) -> str:
    """Return sentences that name the seed of the images on a scene, and the policies without a run of this seed."""
    runs = results.shown(scene)
    shown = {run.policy for run in runs}
    text = f"All images are of seed {runs[0].job.seed}, so all paths begin at the same pose"
    if len({run.job.seed for run in results.of(None, scene)}) > 1:
        result = "C.R." if runs[0].has_truth else "known volume"
        text += f"; of the seeds that most policies finished, it has the median {result}, averaged over the policies"
    others = [p for p in results.policies if p not in shown and results.of(p, scene)]
    return f"{text}." + (f" Without a run of this seed: {', '.join(others)}." if others else "")


def scene_facts(run: Run) -> str:
    """Return sentences on the scene of a run: triangles, size, source, observable surface and notes."""
    info, metrics = run.config["scene"], run.metrics["metrics"]
    size = " × ".join(f"{side:.1f}" for side in info["extent_m"])
    if not run.has_truth:
        return f"A world of {size} m without ground truth."
    seen = f"{metrics['true_area_m2']:.1f} m² of observable surface ({metrics['true_samples']:,} samples)"
    notes = "".join(f" Note: {note}." for note in info["notes"])
    return without_folders(f"{info['triangles']:,} triangles, {size} m, from {info['source']}; {seen}.{notes}")
