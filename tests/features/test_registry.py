"""Features by name, their columns, and the first of them on hand-made maps, against closed forms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.features import FEATURES, Feature, FeatureContext, column_names, evaluate_features
from activestructure_gym.features.hole_area import hidden_distances, largest_area, solid_angles
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN

CAMERA = PinholeCamera.from_size(40, 24)


def context(alpha: np.ndarray, state: np.ndarray | None = None, **changes: Any) -> FeatureContext:
    count = len(alpha)
    poses = np.tile(look_along(np.array([2.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0])), (count, 1, 1))
    state = np.full((40, 40, 40), UNKNOWN, np.uint8) if state is None else state
    options: dict[str, Any] = {
        "mapper": SimpleNamespace(render_depth_alpha=lambda camera, poses: (np.zeros_like(alpha), alpha), keyframes=[]),
        "volume": SimpleNamespace(
            state=state,
            no_return=np.zeros(state.shape, bool),
            origin=np.zeros(3),
            voxel_size=0.1,
        ),
        "planes": None,
        "camera": CAMERA,
        "bounds": np.array([[0.0, 0, 0], [4.0, 4, 4]]),
        "coverage_alpha": 0.5,
        "max_range": 10.0,
        "world_from_camera": poses,
    }
    return FeatureContext(**{**options, **changes})


def test_pixel_gain_is_the_share_of_uncovered_pixels() -> None:
    alpha = np.ones((3, 24, 40), np.float32)
    alpha[1, :6] = 0.5  # exactly at the threshold: not covered
    alpha[2] = 0.0
    np.testing.assert_allclose(evaluate_features(("pixel",), context(alpha))[:, 0], [0.0, 0.25, 1.0])


@pytest.mark.parametrize("picture", ["depth", "alpha"])
def test_a_feature_cannot_change_what_the_next_one_reads(picture: str) -> None:
    def greedy(context: FeatureContext) -> np.ndarray:
        getattr(context, picture)[:] = 0.5
        return np.zeros(3)

    shown = context(np.ones((3, 24, 40), np.float32))
    with pytest.raises(ValueError, match="read-only"):
        greedy(shown)
    assert (shown.alpha == 1.0).all()


def test_a_covered_view_hides_no_area_and_a_wall_nearer_by_hides_less() -> None:
    empty = np.zeros((1, 24, 40), np.float32)
    covered = np.ones((1, 24, 40), np.float32)
    far = np.full((40, 40, 40), UNKNOWN, np.uint8)
    near = np.full((40, 40, 40), FREE, np.uint8)
    near[30:] = OCCUPIED  # a wall 1 m ahead
    assert evaluate_features(("hole_area",), context(covered, far))[0, 0] == 0.0
    gain_far = evaluate_features(("hole_area",), context(empty, far))[0, 0]
    gain_near = evaluate_features(("hole_area",), context(empty, near))[0, 0]
    assert 0 < gain_near < gain_far
    # Frontal wall at depth 1: solid angle x distance^2 is the wall's area seen along the ray, dA cos. The frustum cuts
    # 2 x 1.2 = 2.4 m^2 out of the wall, and the steepest cosine is 0.65.
    assert 2.4 * 0.65 < gain_near * largest_area(CAMERA) < 2.4


def test_hidden_distance_against_the_box() -> None:
    unknown = context(np.zeros((1, 24, 40)))
    pose, rays = unknown.world_from_camera, CAMERA.rays().astype(np.float64)
    wanted = np.ones((1, 24, 40), bool)
    distance = hidden_distances(unknown.volume, CAMERA, pose, 100.0, wanted, stride=1)[0]
    directions = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ pose[0, :3, :3].T
    with np.errstate(divide="ignore"):
        expected = np.min(2.0 / np.abs(directions), axis=-1)
    # Marching stops at most its step of half a voxel before the end.
    assert (distance <= expected + 1e-9).all()
    assert (distance >= expected - 0.05 - 1e-9).all()
    enough = hidden_distances(unknown.volume, CAMERA, pose, 100.0, wanted, stride=1, enough=2.2)[0]
    assert (distance > 2.2).any()
    np.testing.assert_array_equal(np.minimum(enough, 2.2), np.minimum(distance, 2.2))
    wanted[0, ::2] = False
    assert not hidden_distances(unknown.volume, CAMERA, pose, 100.0, wanted, stride=1)[0, ::2].any()


def test_solid_angles_add_up_to_that_of_the_frustum() -> None:
    camera = PinholeCamera.from_size(400, 400, 90.0)
    # A 90 x 90 degree pyramid is a sixth of the sphere.
    assert solid_angles(camera).sum() == pytest.approx(4 * np.pi / 6, rel=1e-4)


def test_what_gains_share_is_computed_once_per_step() -> None:
    calls: list[int] = []

    def covered(context: FeatureContext) -> float:
        calls.append(len(context.alpha))
        return float(context.alpha.mean())

    step = context(np.ones((3, 24, 40), np.float32))
    assert (step.once(covered), step.once(covered)) == (1.0, 1.0)
    assert calls == [3]
    assert context(np.zeros((2, 24, 40), np.float32)).once(covered) == 0.0


def test_a_third_party_gain_is_evaluated_by_name_and_checked() -> None:
    alpha = np.linspace(0, 1, 4, dtype=np.float32)[:, None, None] * np.ones((1, 24, 40), np.float32)

    @FEATURES.register("brightness_of_nothing")
    def mine(ctx: FeatureContext) -> np.ndarray:
        return (1 - ctx.alpha).mean(axis=(1, 2))

    try:
        columns = evaluate_features(("pixel", "brightness_of_nothing"), context(alpha))
        np.testing.assert_allclose(columns[:, 1], [1, 2 / 3, 1 / 3, 0], atol=1e-6)
        for returned, message in (
            (np.full(4, np.nan), "got 4 not finite"),
            (None, "got nothing"),
            (1.0, r"got an array of the shape \(\)"),
            (np.zeros((4, 2)), r"got an array of the shape \(4, 2\)"),
            ("high", "got 'high'"),
        ):
            FEATURES.register("brightness_of_nothing")(lambda ctx, returned=returned: returned)
            with pytest.raises(InputError, match=f"must return 4 finite numbers, one for each candidate, {message}"):
                evaluate_features(("brightness_of_nothing",), context(alpha))
    finally:
        del FEATURES._entries["brightness_of_nothing"]


def test_the_map_is_rendered_once_for_all_gains() -> None:
    calls = []

    def render(camera: PinholeCamera, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls.append(len(poses))
        return np.zeros((2, 24, 40), np.float32), np.zeros((2, 24, 40), np.float32)

    ctx = context(np.zeros((2, 24, 40), np.float32), mapper=SimpleNamespace(render_depth_alpha=render, keyframes=[]))
    evaluate_features(("pixel", "hole_area"), ctx)
    assert calls == [2]


def test_no_candidates_and_unknown_gains() -> None:
    assert evaluate_features(("pixel",), context(np.zeros((0, 24, 40), np.float32))).shape == (0, 1)
    with pytest.raises(InputError, match="did you mean 'pixel'"):
        FEATURES.get("pixle")


@pytest.fixture
def place() -> Iterator[list[int]]:
    """A feature of three columns, registered for the test; what is returned counts how often it was computed."""
    computed: list[int] = []

    @FEATURES.register("place_for_this_test", columns=("", "x", "left_x"), unit=("-", "m", "m"), low=(0.0, -9.0, -9.0))
    def place(ctx: FeatureContext) -> np.ndarray:
        computed.append(len(ctx.world_from_camera))
        return np.arange(3.0 * len(ctx.world_from_camera)).reshape(-1, 3)

    yield computed
    del FEATURES._entries["place_for_this_test"]


def test_a_feature_stands_for_all_its_columns_and_a_column_for_itself(place: list[int]) -> None:
    every = ("place_for_this_test", "place_for_this_test_x", "place_for_this_test_left_x")
    assert FEATURES.columns("place_for_this_test") == column_names(("place_for_this_test",)) == every
    assert column_names(("pixel", "place_for_this_test_x", "place_for_this_test")) == (
        "pixel",
        every[1],
        every[0],
        every[2],
    )
    assert column_names(column_names(("place_for_this_test", "pixel"))) == (*every, "pixel")
    assert [FEATURES.owner(name) for name in every] == ["place_for_this_test"] * 3
    table = evaluate_features(
        ("place_for_this_test_left_x", "pixel", "place_for_this_test"), context(np.ones((2, 24, 40)))
    )
    assert table.dtype == np.float32 and place == [2]  # once for all its columns
    np.testing.assert_array_equal(table, [[2, 0, 0, 1], [5, 0, 3, 4]])


@pytest.mark.parametrize("name", ["place_for_this_test_y", "place_for_this_test_x_", "pixel_x", "_pixel", ""])
def test_an_unknown_column_is_an_unknown_feature(name: str, place: list[int]) -> None:
    with pytest.raises(InputError, match="^unknown feature .* `asg list features` lists the names"):
        column_names((name,))


def test_two_features_cannot_share_a_column(place: list[int]) -> None:
    for name, columns in (("place_for_this_test_x", ("",)), ("place_for_this_test_left", ("x",))):
        FEATURES.register(name, columns=columns)(lambda ctx: np.zeros(len(ctx.world_from_camera)))
        try:
            with pytest.raises(InputError, match=f"is a column of the feature 'place_for_this_test' and of '{name}'"):
                column_names(("place_for_this_test",))
        finally:
            del FEATURES._entries[name]


def test_no_two_of_ours_share_a_column() -> None:
    assert len(column_names(FEATURES)) == sum(len(FEATURES.columns(name)) for name in FEATURES)


def test_a_module_s_feature_has_its_columns_and_a_plain_function_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "columns_for_this_test.py").write_text(
        "import numpy as np\n"
        "from activestructure_gym.features import Feature\n"
        "def plain(context): return np.zeros(len(context.alpha))\n"
        "two = Feature(lambda context: np.ones((len(context.alpha), 2)), columns=('a', 'b_c'))\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    names = column_names(("columns_for_this_test:two_b_c", "columns_for_this_test:plain", "columns_for_this_test:two"))
    assert names == tuple(f"columns_for_this_test:{name}" for name in ("two_b_c", "plain", "two_a"))
    np.testing.assert_array_equal(evaluate_features(names, context(np.ones((2, 24, 40)))), [[1, 0, 1]] * 2)
    with pytest.raises(InputError, match="has no 'two_c'"):
        column_names(("columns_for_this_test:two_c",))


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (
            np.zeros(4),
            r"must return 8 finite numbers, 2 \(one per column\) for each candidate, got an array of the shape \(4,\)",
        ),
        (np.zeros((2, 4)), r"got an array of the shape \(2, 4\)"),
        (np.full((4, 2), np.inf), "got 8 not finite"),
        (None, "got nothing"),
    ],
)
def test_what_a_feature_of_two_columns_must_return(returned: Any, message: str) -> None:
    FEATURES.register("two_for_this_test", columns=("a", "b"))(lambda ctx: returned)
    try:
        with pytest.raises(InputError, match=message):
            evaluate_features(("two_for_this_test",), context(np.ones((4, 24, 40))))
    finally:
        del FEATURES._entries["two_for_this_test"]


@pytest.mark.parametrize(
    "description",
    [
        {"columns": ()},
        {"columns": ("a", "a")},
        {"columns": (1,)},
        {"unit": ("m", "m")},
        {"columns": "xy", "low": (0.0,)},
    ],
)
def test_a_description_that_does_not_fit_is_refused(description: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="of a feature must be"):
        Feature(lambda ctx: np.zeros(0), **description)


def test_a_feature_can_be_called_and_says_what_it_is() -> None:
    from activestructure_gym.features.pixel import pixel

    ctx = context(np.zeros((2, 24, 40), np.float32))
    assert pixel(ctx).tolist() == [1.0, 1.0]
    assert "IG_px" in (pixel.__doc__ or "") and pixel.__module__.endswith("features.pixel")
    assert (pixel.units, pixel.low, pixel.high) == (("share of the image",), (0.0,), (1.0,))
