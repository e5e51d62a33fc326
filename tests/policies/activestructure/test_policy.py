"""Eqs. 11 to 15 by hand, what ends a phase, and what the rungs of the ablation choose."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.errors import InputError
from activestructure_gym.features.unknown_volume import MEAN_DEPTH, REACH
from activestructure_gym.planes import PLANE_FEATURES
from activestructure_gym.policies import Policy, make_policy
from activestructure_gym.policies.activestructure import (
    PHASES,
    ActiveStructure,
    ActiveStructureA,
    ActiveStructureB,
    ActiveStructureC,
    ActiveStructureD,
    PlaneView,
    Weights,
    information_gain,
)
from activestructure_gym.policies.activestructure.information_gain import (
    GOOD_QUALITY,
    VISIBILITY_FLOOR,
    discount,
    plane_view,
    structural_term,
    suppression,
    view_surprise,
)
from activestructure_gym.policies.pixel_only import PixelOnly
from activestructure_gym.sensors.rgbd import SensorConfig
from tests.policies.binding import bound


def planes(visible: list, quality: list, surprise: list, structural: list, area: list | None = None) -> PlaneView:
    q, phi = np.array(quality, float), np.array(surprise, float)
    size = np.ones(len(q)) if area is None else np.array(area, float)
    return PlaneView(np.array(visible, bool), q, phi, (1 - q) * phi, np.array(structural, bool), size)


def observation(
    features: list,  # [K, G]
    *,
    frames: list | None = None,  # [K]
    revisit: tuple[int, ...] = (),  # rows
    visible: list | None = None,  # [K, P]
    quality: tuple[float, ...] = (),  # [P]
    surprise: tuple[float, ...] = (),  # [P]
    structural: tuple[int, ...] = (),  # [P]
    fidelity: float = 30.0,
) -> dict[str, np.ndarray]:
    """An observation with one candidate more than there are, and one plane more: both masked."""
    count, known = len(features), len(quality)
    rows, nodes = count + 1, known + 1
    candidates = np.zeros((rows, len(CANDIDATE_COLUMNS)), np.float32)
    candidates[:count, CANDIDATE_COLUMNS.index("frames")] = [5.0] * count if frames is None else frames
    candidates[list(revisit), CANDIDATE_COLUMNS.index("revisit")] = 1.0
    table = np.zeros((rows, np.shape(features)[1]), np.float32)
    table[:count] = features
    features = np.zeros((nodes, len(PLANE_FEATURES)), np.float32)
    q, phi = np.array(quality), np.array(surprise)
    columns = {"quality": q, "surprise": phi, "deficit": (1 - q) * phi, "structural": structural, "area": 1.0}
    for name, values in columns.items():
        features[:known, PLANE_FEATURES.index(name)] = values
    seen = np.zeros((rows, nodes), np.int8)
    if visible is not None:
        seen[:count, :known] = visible
    return {
        "candidates": candidates,
        "candidate_features": table,
        "action_mask": (np.arange(rows) < count).astype(np.int8),
        "candidate_planes": seen,
        "plane_mask": (np.arange(nodes) < known).astype(np.int8),
        "plane_features": features,
        "fidelity": np.array([fidelity, fidelity + 3.0], np.float32),
    }


# Three views: of planes 0 and 1, of none, of plane 2.
THREE = planes([[1, 1, 0], [0, 0, 0], [0, 0, 1]], [0.5, 0.9, 0.2], [0.2, 0.6, 0.9], [1, 0, 0])


def test_view_surprise_is_half_the_mean_and_half_the_maximum() -> None:
    np.testing.assert_allclose(view_surprise(THREE), [0.5 * 0.4 + 0.5 * 0.6, 0.0, 0.9])


def test_discount_by_hand() -> None:
    expected = 0.3 * (1 - np.exp(-2 / 3)) * (1 - 0.5 / 0.9) * 0.7
    np.testing.assert_allclose(discount(THREE, 0.3), [expected, 0.0, 0.0], atol=1e-12)


def test_discount_grows_with_planes_and_quality_and_falls_with_surprise() -> None:
    beyond = [0, 0, 0, 0, 1]  # the last view sees only the last plane, whose surprise is the largest
    more = np.vstack([np.tril(np.ones((4, 5))), beyond])
    equal = planes(more, [0.6] * 5, [0.1] * 4 + [0.8], [1] * 5)
    assert (np.diff(discount(equal, 0.5)[:4]) > 0).all()

    each = np.eye(5)
    better = planes(each, [0.1, 0.3, 0.5, 0.9, 0.5], [0.1] * 4 + [0.8], [1] * 5)
    assert (np.diff(discount(better, 0.5)[:4]) > 0).all()
    stranger = planes(each, [0.6] * 5, [0.1, 0.3, 0.5, 0.7, 0.8], [1] * 5)
    assert (np.diff(discount(stranger, 0.5)) < 0).all()


def test_discount_stays_between_zero_and_its_cap(rng: np.random.Generator) -> None:
    for cap in (0.0, 0.3, 1.0):
        q, phi = rng.uniform(0, 1, 40), rng.uniform(0, 1, 40)
        rho = discount(planes(rng.uniform(0, 1, (60, 40)) < 0.3, q, phi, [1] * 40), cap)
        assert (rho >= 0).all()
        assert (rho <= cap).all()
    sure = planes(np.ones((1, 40)), [1.0] * 40, [0.0] * 40, [1] * 40)
    assert discount(sure, 0.3)[0] == pytest.approx(0.3, rel=1e-4)  # many perfect planes without surprise: all of it


def test_structural_term_is_the_share_of_what_lacks_with_alpha_by_type() -> None:
    # gamma = 0.1, 0.06, 0.72
    lacks = np.array([0.1, 0.06, 0.72]) / 0.88
    np.testing.assert_allclose(structural_term(THREE, Weights()), [lacks[0] + lacks[1], 0.0, lacks[2]])
    weights = Weights(structural=-2.0, objects=0.5)
    np.testing.assert_allclose(structural_term(THREE, weights), [-2.0 * lacks[0] + 0.5 * lacks[1], 0.0, 0.5 * lacks[2]])
    # Without surprise 1 - q = 0.5, 0.1, 0.8 stands in for gamma.
    np.testing.assert_allclose(structural_term(THREE, Weights(surprise=False)), [0.6 / 1.4, 0.0, 0.8 / 1.4])
    # A share does not change when every surprise shrinks.
    fainter = replace(THREE, deficit=1e-4 * THREE.deficit)
    np.testing.assert_allclose(structural_term(fainter, weights), structural_term(THREE, weights))


def test_total_by_hand() -> None:
    weights = Weights(structural=2.0, objects=0.5, coupling=0.4, deficiency=3.0, max_discount=0.3)
    terms = information_gain(np.array([0.5, 0.4, 0.3]), np.array([0.1, 0.2, 0.0]), THREE, weights)
    rho = 0.3 * (1 - np.exp(-2 / 3)) * (1 - 0.5 / 0.9) * 0.7
    expected = [
        0.5 * (1 - rho) + 0.4 * ((2.0 * 0.1 + 0.5 * 0.06) / 0.88 + 3.0 * 0.1 + VISIBILITY_FLOOR),
        0.4 + 0.4 * 3.0 * 0.2,
        0.3 + 0.4 * (0.5 * 0.72 / 0.88 + VISIBILITY_FLOOR),
    ]
    np.testing.assert_allclose(terms.total, expected)


def test_total_is_never_negative() -> None:
    terms = information_gain(np.zeros(3), np.zeros(3), THREE, Weights(structural=-5.0, objects=-5.0))
    assert terms.structure.min() < -1.0
    np.testing.assert_array_equal(terms.total, 0.0)


def test_a_view_of_any_plane_is_worth_the_floor() -> None:
    complete = replace(THREE, deficit=np.zeros(3))
    terms = information_gain(np.zeros(3), np.zeros(3), complete, Weights())
    np.testing.assert_allclose(terms.total, [VISIBILITY_FLOOR, 0.0, VISIBILITY_FLOOR])


def test_views_dominated_by_good_structure_are_suppressed() -> None:
    views = [[1, 1], [1, 0], [0, 1], [0, 0]]
    good = planes(views, [0.9, 0.9], [0.5, 0.5], [1, 0], area=[3.0, 1.0])
    np.testing.assert_allclose(suppression(good, 0.5), [1 - 0.5 * 0.75, 0.5, 1.0, 1.0])
    np.testing.assert_array_equal(suppression(good, 0.0), 1.0)
    poor = replace(good, quality=np.array([GOOD_QUALITY - 0.01, 0.9]))
    np.testing.assert_array_equal(suppression(poor, 0.5), 1.0)
    pixel = np.full(4, 0.4)
    off, on = (information_gain(pixel, np.zeros(4), good, Weights(suppression=s)).total for s in (0.0, 0.5))
    np.testing.assert_allclose(on, off * [0.625, 0.5, 1.0, 1.0])


def test_rung_a_chooses_as_pixel_only(rng: np.random.Generator) -> None:
    ours, theirs = bound(ActiveStructureA()), bound(PixelOnly())
    chosen = set()
    for _ in range(50):
        observed = observation(
            rng.uniform(0, 1, (9, 1)), frames=rng.uniform(1, 30, 9), visible=rng.uniform(0, 1, (9, 2)) < 0.5,
            quality=(0.1, 0.6), surprise=(0.9, 0.2), structural=(1, 0), revisit=(2,),
        )  # fmt: skip
        assert ours.act(observed) == theirs.act(observed)
        chosen.add(ours.act(observed))
    assert len(chosen) > 3


def test_rung_b_ignores_surprise_and_rung_c_does_not() -> None:
    def choices(quality: tuple, surprise: tuple) -> tuple[int, int]:
        observed = observation(
            [[0.10], [0.05]], visible=[[1, 0], [0, 1]], quality=quality, surprise=surprise, structural=(1, 1)
        )
        return bound(ActiveStructureB()).act(observed), bound(ActiveStructureC()).act(observed)

    assert choices((0.5, 0.5), (0.1, 0.9)) == (0, 1)
    assert choices((0.5, 0.5), (0.9, 0.1)) == (0, 0)
    assert choices((0.9, 0.1), (0.5, 0.5)) == (1, 1)  # the planes themselves count for both


@pytest.mark.parametrize("policy", [ActiveStructureB, ActiveStructureC, ActiveStructure])
def test_a_revisit_is_not_chosen_while_another_view_has_something_to_gain(policy: type) -> None:
    extra = [0.0] * (len(policy().required_features) - 1)
    features = [[0.9, *extra], [0.2, *extra], [0.15, *extra]]
    frames = [1.0, 20.0, 40.0]
    assert bound(policy()).act(observation(features, frames=frames)) == 0
    assert bound(policy()).act(observation(features, frames=frames, revisit=(0,))) == 1
    assert bound(policy()).act(observation(features, frames=frames, revisit=(0, 1))) == 2


@pytest.mark.parametrize(("discovery", "column"), [("pixel", "pixel"), ("unknown_volume", "unknown_volume_way")])
@pytest.mark.parametrize("name", ["activestructure-b", "activestructure-d", "activestructure"])
def test_every_rung_stands_on_any_gain_of_discovery(name: str, discovery: str, column: str) -> None:
    policy = make_policy(f"{name}?discovery={discovery}")
    assert policy.required_features[0] == column
    rest = [0.0] * (len(policy.required_features) - 1)
    policy.reset(0)
    assert bound(policy).act(observation([[0.2, *rest], [0.9, *rest], [0.5, *rest]])) == 1


def test_on_another_base_than_pixels_each_rung_differs_from_the_next_in_one_thing() -> None:
    on_base = [rung.on_base for rung in (ActiveStructureB, ActiveStructureC, ActiveStructureD)]
    first = PHASES[0].weights
    assert [vars(first).keys() & {k for k in vars(first) if vars(w)[k] != vars(first)[k]} for w in on_base] == [
        {"surprise", "max_discount", "sides"}, {"sides"}, {"sides"}
    ]  # fmt: skip
    assert all(weights.sides == 1.0 for weights in on_base)
    assert ActiveStructureD.deficiencies and not ActiveStructureC.deficiencies


def test_on_another_base_a_plane_weighs_what_it_weighs_in_the_full_model() -> None:
    def chosen(policy: Policy, found: float) -> int:
        features = [[0.0] * len(policy.required_features) for _ in range(2)]
        features[0][0] = found
        return bound(policy).act(
            observation(features, visible=[[0], [1]], quality=(0.5,), surprise=(0.5,), structural=(1,))
        )

    for rung in (ActiveStructureB, ActiveStructureC, ActiveStructureD, ActiveStructure):
        if rung is not ActiveStructure:
            assert chosen(rung(discovery="pixel"), 0.05) == 1  # all that the graph lacks counts as a tenth of an image
        assert [chosen(rung(discovery="hole_area"), found) for found in (0.009, 0.012)] == [1, 0]


def test_a_view_into_nothing_but_unknown_space_counts_as_one_whole_image() -> None:
    camera = SensorConfig().camera
    x, y = 0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy
    solid_angle = 4 * math.asin(x * y / math.sqrt((1 + x**2) * (1 + y**2)))
    depth = np.linspace(0, REACH, 10_001)
    opened = solid_angle * np.trapezoid(depth**2 * np.exp(-depth / MEAN_DEPTH), depth)
    policy = bound(ActiveStructureB(discovery="unknown_volume"))
    terms = policy.terms(observation([[opened]]), plane_view(observation([[opened]])), Weights())
    assert terms.total[0] == pytest.approx(1.0, rel=0.02)


def test_an_unknown_gain_of_discovery_is_refused() -> None:
    with pytest.raises(InputError, match="discovery must be pixel, hole_area, unknown_volume, unseen, got 'holes'"):
        make_policy("activestructure-b?discovery=holes")


def test_the_trace_says_what_decided() -> None:
    policy = bound(ActiveStructure(discovery="hole_area"))
    policy.reset(0)
    observed = observation(
        [[0.3, 0.0], [0.6, 0.1], [0.2, 0.0]], visible=[[1], [0], [1]], quality=(0.3,), surprise=(0.4,), structural=(1,)
    )
    assert policy.act(observed) == 1
    trace = policy.trace()
    assert json.loads(json.dumps(trace)) == trace
    assert trace["phase"] == PHASES[0].name
    assert trace["pool"] == 3
    assert trace["runner_up"]["row"] == 0
    assert trace["chosen"]["hole_area"] == pytest.approx(0.6) and "pixel" not in trace["chosen"]
    assert trace["runner_up"]["hole_area"] == pytest.approx(0.3)
    assert trace["chosen"]["deficiency"] == pytest.approx(0.1)
    assert trace["chosen"]["total"] * trace["chosen"]["travel"] > (
        trace["runner_up"]["total"] * trace["runner_up"]["travel"]
    )
