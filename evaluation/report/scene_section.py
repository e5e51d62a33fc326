"""The part of the page about one scene: its table, curves, views, plans, planes and every run's decisions.

Of more policies than fit on a screen only the foremost are shown in full; the others have their views, and thumbnails.
"""

from __future__ import annotations

import copy
import io
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup
from PIL import Image

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.canvas import stored_panels, to_image
from activestructure_gym.evaluation.report.columns import COLUMNS, ratios_text
from activestructure_gym.evaluation.report.curve_section import chart_grid
from activestructure_gym.evaluation.report.embedding import THUMBNAIL, WIDE, picture
from activestructure_gym.evaluation.report.html import html_table, render
from activestructure_gym.evaluation.report.layout import decimal
from activestructure_gym.evaluation.report.phases import plot_phases, stored_timeline
from activestructure_gym.evaluation.report.picture_keys import DEFICIT_KEY, PLAN_KEY, TYPE_KEY
from activestructure_gym.evaluation.report.pictures import BLACK, telling_views
from activestructure_gym.evaluation.report.places import without_places
from activestructure_gym.evaluation.report.plan import draw_plan, flight
from activestructure_gym.evaluation.report.planes_3d import draw_planes_3d
from activestructure_gym.evaluation.report.planes_plan import draw_planes_plan
from activestructure_gym.evaluation.report.results import Results, opened
from activestructure_gym.evaluation.report.run_links import run_links
from activestructure_gym.evaluation.report.tables import overview, table_rows
from activestructure_gym.evaluation.report.traces import run_trace

_TIMELINE = 900  # pixels; its words must be legible
_SEEN = {  # what there is to see in the pictures of planes
    ("type", "from above"): "which planes carry the layout, and how the graph connects them",
    ("type", "in 3D"): "the same; walls that look away are cut away, with their nodes",
    ("deficit", "in 3D"): "on which walls and floors the holes lie",
}


def scene_section(results: Results, scene: str, anchor: str, directory: Path | None = None) -> Markup:
    """The section of one scene, without what stands further up on the page."""
    shown = opened(results.shown(scene))
    full = {run.policy for run in results.foremost(scene)}
    numbers = curves = None
    if len(results.scenes) > 1:
        # Its quality stands among that of all scenes; here its spread over the seeds, if there is one, and its costs.
        columns = COLUMNS if len(results.seeds) > 1 else [column for column in COLUMNS if column.best is None]
        table = overview(table_rows(results.of(None, scene)), name=anchor, columns=columns)
        numbers, curves = html_table(table, colours=results.policies), chart_grid(results, scene)
    return render(
        "scene.html.j2",
        anchor=anchor,
        scene=scene,
        facts=scene_facts(shown[0]),
        numbers=numbers,
        curves=curves,
        which_runs=which_runs(results, scene),
        views=views_strip(shown, results.policies),
        black=BLACK,
        plans=[_plan(run, results.policies, full, directory) for run in shown],
        plan_key=PLAN_KEY,
        flight=flight([(run.trajectory, run.graph) for run in shown]),
        graphs=[_planes(run, results.policies, full) for run in shown if run.graph is not None],
        deficit_key=DEFICIT_KEY,
        type_key=TYPE_KEY,
        traces=[
            run_trace(copy.copy(run), directory) for policy in results.policies for run in results.of(policy, scene)
        ],
    )


def which_runs(results: Results, scene: str) -> str:
    """Whose pictures are shown, and who has none."""
    runs = results.shown(scene)
    shown = {run.policy for run in runs}
    text = f"All pictures are of seed {runs[0].job.seed}, so that every path begins at the same place"
    if len({run.job.seed for run in results.of(None, scene)}) > 1:
        text += "; of the seeds it is the one with the median C.R., averaged over the policies"
    others = [p for p in results.policies if p not in shown and results.of(p, scene)]
    return f"{text}." + (f" Without a run of this seed: {', '.join(others)}." if others else "")


def scene_facts(run: Run) -> str:
    """Sentences on the scene of a run."""
    info, metrics = run.config["scene"], run.metrics["metrics"]
    size = " × ".join(f"{side:.1f}" for side in info["extent_m"])
    seen = f"{metrics['true_area_m2']:.1f} m² of surface can be seen ({metrics['true_samples']:,} samples)"
    notes = "".join(f" Note: {note}." for note in info["notes"])
    return without_places(f"{info['triangles']:,} triangles, {size} m, from {info['source']}; {seen}.{notes}")


def views_strip(runs: Sequence[Run], policies: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of the same held-out views: the truth, and what every run renders there, with its PSNR."""
    true = runs[0].pictures["true"]
    telling = telling_views(true)
    views: list[dict[str, Any]] = [
        {"picture": picture(to_image(true[i]), f"true view {i + 1}"), "psnr": None} for i in telling
    ]
    rows: list[dict[str, Any]] = [{"name": "true view", "index": None, "result": "", "views": views}]
    best = {i: max(float(run.pictures["psnr"][i]) for run in runs) for i in telling}
    for run in runs:
        views = []
        for i in telling:
            psnr = float(run.pictures["psnr"][i])
            alt = f"view {i + 1} as {run.policy} reconstructed it, PSNR {psnr:.2f} dB"
            drawn = picture(to_image(run.pictures["rendered"][i]), alt)
            views.append({"picture": drawn, "psnr": decimal(psnr, 2), "best": len(runs) > 1 and psnr == best[i]})
        rows.append({"name": run.policy, "index": policies.index(run.policy), "result": _result(run), "views": views})
    return rows


def _plan(run: Run, policies: Sequence[str], full: Collection[str], directory: Path | None) -> dict[str, Any]:
    """A run's map from above, with what it knew and the way it went."""
    drawn = draw_plan(run.pictures, run.trajectory, WIDE if run.policy in full else THUMBNAIL)
    shown = _tile(run, policies, picture(drawn, f"plan with the path of {run.policy}"))
    return shown | {"links": run_links(run, directory)}


def _planes(run: Run, policies: Sequence[str], full: Collection[str]) -> dict[str, Any]:
    """A run's graph from above by deficit; in ``full`` also by type and in three dimensions, and how it came about."""
    assert run.graph is not None
    # The run's own pictures where they can be used: drawing them again takes as long as the rest of the page.
    above = stored_panels(run.directory / "psg_plan.png") or draw_planes_plan(run.graph, run.pictures)
    if run.policy not in full:
        drawn = picture(above[1], f"planes of {run.policy} from above, by deficit", widest=THUMBNAIL)
        return {"by_deficit": _tile(run, policies, drawn), "pictures": []}
    in_3d = stored_panels(run.directory / "psg_3d.png") or draw_planes_3d(run.graph)
    drawn = {
        (what, place): picture(image, f"planes of {run.policy} {place}, by {what}")
        for place, images in (("from above", above), ("in 3D", in_3d))
        for what, image in zip(("type", "deficit"), images)
    }
    count, structural = len(run.graph["ids"]), int(run.graph["structural"].sum())
    holes = run.graph["deficiency_areas"]
    return {
        "by_deficit": _tile(run, policies, drawn["deficit", "from above"]),
        "pictures": [(f"by {what}, {place}", says, drawn[what, place]) for (what, place), says in _SEEN.items()],
        "history": picture(_history(run), f"timeline of {run.policy}", widest=_TIMELINE),
        "says": f"{run.policy}, seed {run.job.seed}: {structural} structural planes, {count - structural} of objects, "
        f"{len(holes)} deficiency centres for {holes.sum():.1f} m²",
    }


def _history(run: Run) -> Image.Image:
    """The run's own timeline, which takes seconds to draw; drawn again where it cannot be used."""
    stored = stored_timeline(run.directory / "phases.png")
    if stored is not None:
        return stored
    buffer = io.BytesIO()
    plot_phases([("", run.steps)], buffer, title="")
    return Image.open(buffer)


def _tile(run: Run, policies: Sequence[str], drawn: Markup) -> dict[str, Any]:
    return {
        "picture": drawn,
        "index": policies.index(run.policy),
        "policy": run.policy,
        "result": _result(run),
        "links": [],
    }


def _result(run: Run) -> str:
    metrics = run.metrics["metrics"]
    return (
        f"seed {run.job.seed}, {metrics['frames']} frames, {metrics['metres']:.1f} m, "
        f"{ratios_text(run)}, {metrics['psnr']:.2f} dB"
    )
