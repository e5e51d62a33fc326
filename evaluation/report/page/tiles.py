"""Build the page's tiles: images of single runs, each with the run's result and a caption."""

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
from activestructure_gym.evaluation.report.pictures.views_and_plans import detailed_views, reference_word
from activestructure_gym.evaluation.report.tables.columns import ratios_text
from activestructure_gym.evaluation.report.tables.layout import decimal

_HIGH_DEFICIT = 0.01  # deficit of a plane that captions call high: the middle border of the legend's classes
_CAPTIONS = {  # captions of the images of planes, by colour coding and projection
    ("type", "from above"): "structural and object planes, and the edges of the graph",
    ("type", "in 3D"): "structural and object planes; planes that face away are left out",
    ("deficit", "in 3D"): "deficits of the planes, and deficiency centres",
}


@dataclass(frozen=True)
class Tiles:
    """Hold the settings of all tiles."""

    palette: Sequence[str]  # policies in the order of their colours
    full: frozenset[str]  # policies with images in full size
    directory: Path | None = None  # directory of the page; None for no links

    def width(self, run: Run) -> int:
        """Return the largest width of a run's images in pixels."""
        return WIDE if run.policy in self.full else THUMBNAIL

    def tile(self, run: Run, drawn: Markup, caption: str) -> dict[str, Any]:
        """Return the fields of a tile for the template: the image ``drawn``, the caption, and the run's result."""
        index, links, result = self.palette.index(run.policy), run_links(run, self.directory), result_text(run)
        if run.policy not in self.full:  # a thumbnail has room for a short text only
            ratio = run.metrics["metrics"]["completion_ratio"]
            result = "" if ratio is None else f"C.R. {ratio:.1f} %"
            links = [link for link in links if link.name in ("replay", "plan", "planes in 3D")]
        return {
            "picture": drawn,
            "index": index,
            "policy": run.policy,
            "result": result,
            "caption": caption,
            "links": links,
        }


def views_strip(runs: Sequence[Run], tiles: Tiles) -> list[dict[str, Any]]:
    """Return rows of the same held-out views for the template: true views, then each run's rendered views with PSNR."""
    true, word = runs[0].pictures["true"], reference_word(runs[0])
    telling = detailed_views(true)
    views: list[dict[str, Any]] = [
        {"picture": picture(to_image(true[i]), f"{word} view {i + 1}"), "psnr": None} for i in telling
    ]
    rows: list[dict[str, Any]] = [{"name": f"{word} view", "index": None, "result": "", "views": views}]
    ranked = ranked_among({run.job.policy for run in runs})
    among = [run for run in runs if run.job.policy in ranked]
    best = {i: max(among or runs, key=lambda run: float(run.pictures["psnr"][i])) for i in telling}
    for run in runs:
        views = []
        for i in telling:
            psnr, highest = float(run.pictures["psnr"][i]), float(best[i].pictures["psnr"][i])
            first = len(among) > 1 and run in among and psnr == highest
            alt = f"view {i + 1} rendered from the map of {run.policy}, PSNR {psnr:.2f} dB"
            if first:
                alt += ": the best"
            elif len(runs) > 1 and run is not best[i]:
                alt += f": {abs(highest - psnr):.2f} dB {'above' if psnr > highest else 'below'} {best[i].policy}"
            drawn = picture(to_image(run.pictures["rendered"][i]), alt, widest=tiles.width(run))
            views.append({"picture": drawn, "psnr": decimal(psnr, 2), "best": first})
        rows.append(tiles.tile(run, Markup(), "") | {"name": run.policy, "views": views})
    return rows


def plan_tile(run: Run, tiles: Tiles) -> dict[str, Any]:
    """Return the tile of a run's plan: map from above, observed space and path."""
    drawn = draw_plan(run.pictures, run.trajectory, tiles.width(run))
    caption = f"{100 * float(np.mean(run.pictures['plan_state'] > 0)):.0f} % of the plan observed, the rest is grey"
    return tiles.tile(run, picture(drawn, f"map of {run.policy} from above with its path: {caption}"), caption)


def planes_tile(run: Run, tiles: Tiles) -> dict[str, Any]:
    """Return the tile of a run's Plane Scene Graph: planes from above, coloured by deficit.

    For policies with images in full size, ``pictures`` has planes coloured by type and planes in 3D.
    """
    assert run.graph is not None
    # Stored images are used if they exist, since drawing them again takes as long as the rest of the page.
    above = stored_panels(run.directory / "psg_plan.png") or draw_planes_plan(run.graph, run.pictures)
    caption, width = _deficit_text(run.graph), tiles.width(run)
    by_deficit = picture(above[1], f"planes of {run.policy} from above, by deficit: {caption}", widest=width)
    tile = {"by_deficit": tiles.tile(run, by_deficit, caption), "pictures": []}
    if run.policy not in tiles.full:
        return tile
    in_3d = stored_panels(run.directory / "psg_3d.png") or draw_planes_3d(run.graph)
    images = {("type", "from above"): above[0], ("type", "in 3D"): in_3d[0], ("deficit", "in 3D"): in_3d[1]}
    drawn = [
        (f"by {what}, {place}", seen,
         picture(images[what, place], f"planes of {run.policy} {place}, by {what}: {seen}", widest=width))
        for (what, place), seen in _CAPTIONS.items()
    ]  # fmt: skip
    count, structural = len(run.graph["ids"]), int(run.graph["structural"].sum())
    return tile | {
        "pictures": drawn,
        "caption": f"{run.policy}, seed {run.job.seed}: {structural} structural planes, {count - structural} object "
        f"planes, {_holes_text(run.graph)}",
    }


def result_text(run: Run) -> str:
    """Return the seed, the costs and the main results of a run in one line."""
    metrics = run.metrics["metrics"]
    quality = f", {metrics['psnr']:.2f} dB" if run.has_truth else ""
    return f"seed {run.job.seed}, {metrics['frames']} frames, {metrics['metres']:.1f} m, {ratios_text(run)}{quality}"


def _deficit_text(graph: Mapping[str, np.ndarray]) -> str:
    areas = graph["areas"]
    share = 100 * float(areas[graph["deficit"] >= _HIGH_DEFICIT].sum()) / (float(areas.sum()) or 1.0)
    return (
        f"{_holes_text(graph)} of deficient surface; planes with a deficit of at least {_HIGH_DEFICIT:g} have "
        f"{share:.0f} % of the planes' area"
    )


def _holes_text(graph: Mapping[str, np.ndarray]) -> str:
    holes = graph["deficiency_areas"]
    return f"{len(holes)} deficiency centre{'' if len(holes) == 1 else 's'} with {holes.sum():.1f} m²"
