"""The part of the page about one scene: its table, curves, views, plans, planes and every run's decisions."""

from __future__ import annotations

import io
from collections.abc import Sequence

from PIL import Image

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.canvas import stored_panels, to_image
from activestructure_gym.evaluation.report.charts import panel_chart
from activestructure_gym.evaluation.report.columns import COLUMNS
from activestructure_gym.evaluation.report.curves import COSTS, MEASURES, chart_rows, convergence
from activestructure_gym.evaluation.report.embedding import picture
from activestructure_gym.evaluation.report.html import Html, element, folded, html_table, joined
from activestructure_gym.evaluation.report.layout import decimal
from activestructure_gym.evaluation.report.phases import plot_phases, stored_timeline
from activestructure_gym.evaluation.report.pictures import BLACK, telling_views
from activestructure_gym.evaluation.report.places import without_places
from activestructure_gym.evaluation.report.plan import FILLS, draw_plan, flight
from activestructure_gym.evaluation.report.planes_3d import draw_planes_3d
from activestructure_gym.evaluation.report.planes_plan import draw_planes_plan
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables import overview, table_rows
from activestructure_gym.evaluation.report.traces import run_trace
from activestructure_gym.evaluation.statistics import Statistic, mean

_TIMELINE = 900  # pixels; its words must be legible
_SEEN = {  # what there is to see in the pictures of planes
    ("type", "from above"): "which planes carry the layout, and how the graph connects them",
    ("type", "in 3D"): "the same; walls that look away are cut away, with their nodes",
    ("deficit", "in 3D"): "on which walls and floors the holes lie",
}


def _css(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


_WAY = ",".join(_css(style.path_colour(share / 4)) for share in range(5))
_CLASSES = (f"deficit < {style.DEFICIT_BOUNDS[0]:g}", *(f"{bound:g} +" for bound in style.DEFICIT_BOUNDS))
# Label, shape and CSS background of every sign.
PLAN_KEY = (
    ("start", "disc", _css(style.START)), ("end", "square", _css(style.END)),
    ("path, first to last frame", "line", f"linear-gradient(90deg,{_WAY})"),
    ("keyframe, looking ahead", "dotted", _css(style.INK)),
    *((label, "box", _css(colour)) for label, colour in FILLS.items()),
)  # fmt: skip
TYPE_KEY = (
    ("structural plane", "box", _css(style.STRUCTURAL)), ("object plane", "box", _css(style.OBJECT)),
    ("facing down, as the ceiling", "outline", "transparent"), ("centroid", "disc", _css(style.STRUCTURAL)),
    ("spanning tree", "line", _css(style.TREE)), ("other edge", "hair", _css(style.EDGE)),
)  # fmt: skip
DEFICIT_KEY = (
    *((label, "box", _css(colour)) for label, colour in zip(_CLASSES, style.DEFICIT_COLOURS)),
    ("deficiency centre, by area", "ring", _css(style.PAPER)),
)


def scene_section(results: Results, scene: str, anchor: str) -> Html:
    """Everything about one scene that does not stand further up on the page."""
    shown = results.shown(scene)
    parts: list[Html | None] = [element("h2", scene), scene_facts(shown[0])]
    if len(results.scenes) > 1:
        # Its quality stands among that of all scenes; here its spread over the seeds, if there is one, and its costs.
        columns = COLUMNS if len(results.seeds) > 1 else [column for column in COLUMNS if column.best is None]
        table = overview(table_rows(results.of(None, scene)), name=anchor, columns=columns)
        parts += [html_table(table, colours=results.policies), element("h3", "Convergence"), chart_grid(results, scene)]
    parts += [
        element("p", which_runs(results, scene), class_="facts"),
        element("h3", "Held-out views"),
        views_strip(shown, results.policies),
        element("h3", "Paths"),
        plans(shown, results.policies),
    ]
    with_graph = [run for run in shown if run.graph is not None]
    if with_graph:
        parts += [element("h3", "Plane Scene Graphs"), planes(with_graph, results.policies)]
    parts.append(element("h3", "Decisions"))
    parts += [run_trace(run) for policy in results.policies for run in results.of(policy, scene)]
    return element("section", *parts, id_=anchor)


def which_runs(results: Results, scene: str) -> str:
    """Whose pictures are shown, and who has none."""
    runs = results.shown(scene)
    shown = {run.policy for run in runs}
    text = f"All pictures are of seed {runs[0].job.seed}, so that every path begins at the same place"
    if len({run.job.seed for run in results.of(None, scene)}) > 1:
        text += "; of the seeds it is the one with the median C.R., averaged over the policies"
    others = [p for p in results.policies if p not in shown and results.of(p, scene)]
    return f"{text}." + (f" Without a run of this seed: {', '.join(others)}." if others else "")


def scene_facts(run: Run) -> Html:
    """What the scene is."""
    info, metrics = run.config["scene"], run.metrics["metrics"]
    size = " × ".join(f"{side:.1f}" for side in info["extent_m"])
    seen = f"{metrics['true_area_m2']:.1f} m² of surface can be seen ({metrics['true_samples']:,} samples)"
    notes = "".join(f" Note: {note}." for note in info["notes"])
    text = f"{info['triangles']:,} triangles, {size} m, from {info['source']}; {seen}.{notes}"
    return element("p", without_places(text), class_="facts")


def chart_grid(results: Results, scene: str | None = None, statistic: Statistic = mean) -> Html:
    """C.R. and PSNR over frames, metres and seconds."""
    charts = [chart for row in chart_rows(results, scene, statistic) for chart in row]
    caption = element(
        "figcaption",
        "The higher and the further left, the better. Charts side by side have one vertical axis; seconds begin where "
        "the first decision has ended, and a chart may end where no curve moves any more.",
    )
    return element("figure", caption, element("div", *charts, class_="charts"))


def policy_panels(results: Results) -> list[Html]:
    """C.R. and PSNR over the frames with a panel for each policy; none while colours tell all policies apart."""
    if len(results.policies) <= len(style.COLOURS):
        return []
    frames = COSTS[0]
    return [
        panel_chart(
            convergence(results, frames.key, measure.key),
            title=f"{measure.label} over {frames.label}, policy by policy",
            x_label=frames.label,
            y_label=measure.label,
        )
        for measure in MEASURES
    ]


def views_strip(runs: Sequence[Run], policies: Sequence[str]) -> Html:
    """Rows of the same held-out views: the truth, and what every run renders there, its PSNR in the corner."""
    true = runs[0].pictures["true"]
    telling = telling_views(true)
    rows = [_view_row("true view", "", [(to_image(true[i]), f"true view {i + 1}", None) for i in telling], None)]
    best = {i: max(float(run.pictures["psnr"][i]) for run in runs) for i in telling}
    for run in runs:
        tiles = []
        for i in telling:
            psnr = float(run.pictures["psnr"][i])
            alt = f"view {i + 1} as {run.policy} reconstructed it, PSNR {psnr:.2f} dB"
            badge = element("b", decimal(psnr, 2), class_="first" if len(runs) > 1 and psnr == best[i] else None)
            tiles.append((to_image(run.pictures["rendered"][i]), alt, badge))
        rows.append(_view_row(run.policy, _result(run), tiles, policies.index(run.policy)))
    caption = element(
        "figcaption",
        "The nearer a picture comes to the true one above it, the better: PSNR in dB in the corner, the best of a view "
        f"in gold. The views are those with most detail in the true image. {BLACK}",
    )
    return element("figure", caption, element("div", *rows, class_="strip"))


def plans(runs: Sequence[Run], policies: Sequence[str]) -> Html:
    """Every run's map from above, with what it knew and the way it went."""
    tiles = []
    for run in runs:
        drawn = picture(draw_plan(run.pictures, run.trajectory), f"plan with the path of {run.policy}")
        tiles.append(_tile(run, policies, drawn))
    caption = element(
        "figcaption",
        "The map from above without ceilings, and the way through it: places the path never looked into are grey. "
        f"{flight([(run.trajectory, run.graph) for run in runs])}",
    )
    return element("figure", caption, key(PLAN_KEY), element("div", *tiles, class_="tiles"))


def planes(runs: Sequence[Run], policies: Sequence[str]) -> Html:
    """Every run's graph: from above and in three dimensions, by type and by deficit; and how it came about."""
    blocks, plans_by_deficit = [], []
    for run in runs:
        assert run.graph is not None
        pictures: list[Html] = []
        # The run's own pictures where they can be used: drawing them again takes as long as the rest of the page.
        above = stored_panels(run.directory / "psg_plan.png") or draw_planes_plan(run.graph, run.pictures)
        in_3d = stored_panels(run.directory / "psg_3d.png") or draw_planes_3d(run.graph)
        for place, drawn in (("from above", above), ("in 3D", in_3d)):
            for what, image in zip(("type", "deficit"), drawn):
                drawing = picture(image, f"planes of {run.policy} {place}, by {what}", drawing=True)
                if (place, what) == ("from above", "deficit"):
                    plans_by_deficit.append(_tile(run, policies, drawing))
                else:
                    caption = element("figcaption", element("strong", f"by {what}, {place}"), f": {_SEEN[what, place]}")
                    pictures.append(element("figure", drawing, caption))
        history = picture(_history(run), f"timeline of {run.policy}", drawing=True, widest=_TIMELINE)
        caption = element(
            "figcaption", "What is still missing, and what decided, frame by frame: deficits should fall."
        )
        over_time = element("figure", caption, history, class_="over-time")
        count, structural = len(run.graph["ids"]), int(run.graph["structural"].sum())
        holes = run.graph["deficiency_areas"]
        line = (
            f"{run.policy}, seed {run.job.seed}: {structural} structural planes, {count - structural} of objects, "
            f"{len(holes)} deficiency centres for {holes.sum():.1f} m²"
        )
        blocks.append(folded(line, element("div", *pictures, class_="tiles paper"), over_time, class_="planes"))
    plans_above = element("div", *plans_by_deficit, class_="tiles paper")
    says = "The darker a plane, the more of it is missing or badly seen; circles stand where to look next."
    more = element("p", "By type, in three dimensions, and over the frames:", class_="facts")
    caption = element("p", says, class_="facts")
    return element("div", caption, key(DEFICIT_KEY), plans_above, more, key(TYPE_KEY), *blocks)


def _history(run: Run) -> Image.Image:
    """The run's own timeline, which takes seconds to draw; drawn again where it cannot be used."""
    stored = stored_timeline(run.directory / "phases.png")
    if stored is not None:
        return stored
    buffer = io.BytesIO()
    plot_phases([("", run.steps)], buffer, title="")
    return Image.open(buffer)


def key(entries: Sequence[tuple[str, str, str]]) -> Html:
    """What the signs of a picture mean: label, shape and CSS background of each."""
    items = (
        joined(element("i", class_=f"sign {shape}", style=f"background:{colour}", aria_hidden="true"), label)
        for label, shape, colour in entries
    )
    return element("ul", *(element("li", item) for item in items), class_="keys")


def _view_row(name: str, more: str, tiles: Sequence[tuple[Image.Image, str, Html | None]], index: int | None) -> Html:
    dot = element("i", class_=f"dot p{index % 8}", aria_hidden="true") if index is not None else None
    label = element("div", element("div", dot, element("strong", name)), element("span", more), class_="who")
    pictures = [element("figure", picture(image, alt), badge) for image, alt, badge in tiles]
    return element("div", label, *pictures, class_="views")


def _tile(run: Run, policies: Sequence[str], image: Html) -> Html:
    dot = element("i", class_=f"dot p{policies.index(run.policy) % 8}", aria_hidden="true")
    caption = element("figcaption", dot, element("strong", run.policy), f" {_result(run)}")
    return element("figure", image, caption)


def _result(run: Run) -> str:
    metrics = run.metrics["metrics"]
    return (
        f"seed {run.job.seed}, {metrics['frames']} frames, {metrics['metres']:.1f} m, "
        f"C.R. {metrics['completion_ratio']:.1f} %, {metrics['psnr']:.2f} dB"
    )
