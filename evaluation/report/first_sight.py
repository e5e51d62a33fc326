"""What a reader sees first: one view and one path per policy, side by side, of one scene and one seed."""

from __future__ import annotations

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.canvas import to_image
from activestructure_gym.evaluation.report.embedding import picture
from activestructure_gym.evaluation.report.html import Html, element, joined
from activestructure_gym.evaluation.report.layout import decimal
from activestructure_gym.evaluation.report.pictures import BLACK, typical_view
from activestructure_gym.evaluation.report.plan import draw_plan, flight
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.scene_section import PLAN_KEY, key


def first_sight(results: Results, anchor: str) -> Html:
    """The first scene's typical view, true and as every map renders it, and below it every map with its path."""
    everyone = results.shown(results.scenes[0])
    runs = results.foremost(results.scenes[0])
    index = typical_view(runs)
    truth = picture(to_image(runs[0].pictures["true"][index]), "the true view")
    tiles = [
        element(
            "figure",
            element("figcaption", element("strong", "true view"), element("span", "to compare with")),
            truth,
            key(PLAN_KEY),
        )
    ]
    tiles += [_tile(run, index, results.policies.index(run.policy)) for run in runs]
    where = f"{results.scenes[0]}, seed {runs[0].job.seed}"
    if len(runs) < len(everyone):
        where += f", the {len(runs)} policies with the highest C.R. (the baseline among them) of {len(everyone)}"
    caption = element(
        "figcaption",
        f"{where}. Above, a view that no policy has chosen: of the four with most detail that with the median PSNR. "
        f"{BLACK} "
        f"Below, the map from above with the path. {flight([(run.trajectory, run.graph) for run in runs])} ",
        joined("More stand ", element("a", "with the scene", href=f"#{anchor}"), ". A click enlarges a picture."),
    )
    return element("figure", element("div", *tiles, class_="sight"), caption, class_="opening")


def _tile(run: Run, index: int, number: int) -> Html:
    policy, metrics = run.policy, run.metrics["metrics"]
    dot = element("i", class_=f"dot p{number % 8}", aria_hidden="true")
    numbers = element("span", f"C.R. {metrics['completion_ratio']:.1f} %, {metrics['metres']:.1f} m")
    view = picture(to_image(run.pictures["rendered"][index]), f"the same view in the map of {policy}")
    badge = element("b", f"{decimal(float(run.pictures['psnr'][index]), 1)} dB")
    plan = picture(draw_plan(run.pictures, run.trajectory), f"the map of {policy} from above, with the path")
    return element(
        "figure",
        element("figcaption", dot, element("strong", policy), numbers),
        element("div", view, badge, class_="corner"),
        element("div", plan, class_="plan"),
    )
