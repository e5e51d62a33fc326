"""Pictures of single runs on the page, each with a sentence of what there is to see in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from activestructure_gym.evaluation.archive.jobs import ranked_among
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.page.data_uris import THUMBNAIL, WIDE, picture
from activestructure_gym.evaluation.report.page.run_links import run_links
from activestructure_gym.evaluation.report.pictures.canvas import stored_panels, to_image
from activestructure_gym.evaluation.report.pictures.floor_plan import draw_plan
from activestructure_gym.evaluation.report.pictures.psg_3d import draw_planes_3d
from activestructure_gym.evaluation.report.pictures.psg_plan import draw_planes_plan
from activestructure_gym.evaluation.report.pictures.views_and_plans import telling_views
from activestructure_gym.evaluation.report.tables.columns import ratios_text
from activestructure_gym.evaluation.report.tables.layout import decimal

_BAD = 0.01  # a deficit from which a plane is called lacking: the middle of the key's classes
_SEEN = {  # what there is to see in the pictures of planes
    ("type", "from above"): "which planes carry the layout, and how the graph connects them",
    ("type", "in 3D"): "the same; walls that look away are cut away, with their nodes",
    ("deficit", "in 3D"): "on which walls and floors the holes lie",
}


@dataclass(frozen=True)
class Tiles:
    """How runs are shown: the order of their colours, who is shown in full, and where the page will lie."""

    palette: Sequence[str]  # policies
    full: frozenset[str]
    directory: Path | None = None

    def width(self, run: Run) -> int:
        """Pixels of a run's pictures."""
        return WIDE if run.policy in self.full else THUMBNAIL

    def tile(self, run: Run, drawn: Markup, says: str) -> dict[str, Any]:
        """A picture above the run's numbers."""
        index, links, result = self.palette.index(run.policy), run_links(run, self.directory), result_text(run)
        if run.policy not in self.full:  # a thumbnail has no room
            result = f"C.R. {run.metrics['metrics']['completion_ratio']:.1f} %"
            links = [link for link in links if link.name in ("replay", "plan", "planes in 3D")]
        return {"picture": drawn, "index": index, "policy": run.policy, "result": result, "says": says, "links": links}


def views_strip(runs: Sequence[Run], tiles: Tiles) -> list[dict[str, Any]]:
    """Rows of the same held-out views: the truth, and what every run renders there, with its PSNR."""
    true = runs[0].pictures["true"]
    telling = telling_views(true)
    views: list[dict[str, Any]] = [
        {"picture": picture(to_image(true[i]), f"view {i + 1} as it is: what every map should show"), "psnr": None}
        for i in telling
    ]
    rows: list[dict[str, Any]] = [{"name": "true view", "index": None, "result": "", "views": views}]
    ranked = ranked_among({run.job.policy for run in runs})
    among = [run for run in runs if run.job.policy in ranked]
    best = {i: max(among or runs, key=lambda run: float(run.pictures["psnr"][i])) for i in telling}
    for run in runs:
        views = []
        for i in telling:
            psnr, highest = float(run.pictures["psnr"][i]), float(best[i].pictures["psnr"][i])
            first = len(among) > 1 and run in among and psnr == highest
            alt = f"view {i + 1} in the map of {run.policy}, PSNR {psnr:.2f} dB"
            if first:
                alt += ": the best"
            elif len(runs) > 1 and run is not best[i]:
                alt += f": {abs(highest - psnr):.2f} dB {'above' if psnr > highest else 'below'} {best[i].policy}"
            drawn = picture(to_image(run.pictures["rendered"][i]), alt, widest=tiles.width(run))
            views.append({"picture": drawn, "psnr": decimal(psnr, 2), "best": first})
        rows.append(tiles.tile(run, Markup(), "") | {"name": run.policy, "views": views})
    return rows


def plan_tile(run: Run, tiles: Tiles) -> dict[str, Any]:
    """A run's map from above, with what it knew and the way it went."""
    drawn = draw_plan(run.pictures, run.trajectory, tiles.width(run))
    says = f"{100 * float(np.mean(run.pictures['plan_state'] > 0)):.0f} % of the plan was looked into, grey was not"
    return tiles.tile(run, picture(drawn, f"map of {run.policy} from above with its path: {says}"), says)


def planes_tile(run: Run, tiles: Tiles) -> dict[str, Any]:
    """A run's graph from above by deficit; of a run in full also by type and in three dimensions."""
    assert run.graph is not None
    # The run's own pictures where they can be used: drawing them again takes as long as the rest of the page.
    above = stored_panels(run.directory / "psg_plan.png") or draw_planes_plan(run.graph, run.pictures)
    says, width = _lacks(run.graph), tiles.width(run)
    by_deficit = picture(above[1], f"planes of {run.policy} from above, by deficit: {says}", widest=width)
    tile = {"by_deficit": tiles.tile(run, by_deficit, says), "pictures": []}
    if run.policy not in tiles.full:
        return tile
    in_3d = stored_panels(run.directory / "psg_3d.png") or draw_planes_3d(run.graph)
    images = {("type", "from above"): above[0], ("type", "in 3D"): in_3d[0], ("deficit", "in 3D"): in_3d[1]}
    drawn = [
        (f"by {what}, {place}", seen,
         picture(images[what, place], f"planes of {run.policy} {place}, by {what}: {seen}", widest=width))
        for (what, place), seen in _SEEN.items()
    ]  # fmt: skip
    count, structural = len(run.graph["ids"]), int(run.graph["structural"].sum())
    return tile | {
        "pictures": drawn,
        "says": f"{run.policy}, seed {run.job.seed}: {structural} structural planes, {count - structural} of objects, "
        f"{_holes(run.graph)}",
    }


def result_text(run: Run) -> str:
    """What a run spent and reached, in a line."""
    metrics = run.metrics["metrics"]
    return (
        f"seed {run.job.seed}, {metrics['frames']} frames, {metrics['metres']:.1f} m, "
        f"{ratios_text(run)}, {metrics['psnr']:.2f} dB"
    )


def _lacks(graph: Mapping[str, np.ndarray]) -> str:
    areas = graph["areas"]
    share = 100 * float(areas[graph["deficit"] >= _BAD].sum()) / (float(areas.sum()) or 1.0)
    return f"{_holes(graph)} left; {share:.0f} % of the planes' area has a deficit of {_BAD:g} or more"


def _holes(graph: Mapping[str, np.ndarray]) -> str:
    holes = graph["deficiency_areas"]
    return f"{len(holes)} deficiency centre{'' if len(holes) == 1 else 's'} for {holes.sum():.1f} m²"
