"""Draw the images of one run from its stored arrays."""

from __future__ import annotations

from pathlib import Path

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.pictures.canvas import save_with_panels
from activestructure_gym.evaluation.report.pictures.psg_figures import run_planes_3d, run_planes_plan
from activestructure_gym.evaluation.report.pictures.views_and_plans import run_plan, run_views

VIEWS = "views.png"


def draw_run(run: Run, directory: Path) -> None:
    """Draw the held-out views, the plan and the Plane Scene Graph of a finished run as PNG files in ``directory``."""
    title = run.job.title
    run_views(run, title=title).save(directory / VIEWS)
    run_plan(run.pictures, run.trajectory, run.graph, title=title).save(directory / "plan.png")
    if run.graph is not None:
        plan, plan_panels = run_planes_plan(run.graph, run.pictures, title=title)
        save_with_panels(plan, directory / "psg_plan.png", plan_panels)
        in_3d, panels_3d = run_planes_3d(run.graph, title=title)
        save_with_panels(in_3d, directory / "psg_3d.png", panels_3d)
