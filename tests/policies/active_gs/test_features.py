"""Confidence of Gaussians by hand, and the two halves of ActiveGS's utility on a wall."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.view_directions import ViewDirections
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.policies.active_gs import features
from activestructure_gym.policies.active_gs.features import gaussian_confidence
from activestructure_gym.sensors import Frame
from activestructure_gym.volume import FREE, UNKNOWN, VoxelVolume

CAMERA = PinholeCamera.from_size(64, 36, 90.0)
FORWARD = np.array([1.0, 0.0, 0.0])


def test_confidence_by_hand() -> None:
    seen = ViewDirections(
        count=np.array([0, 1, 2, 9], np.int32),
        nearness=np.array([0.0, 0.3, 0.3, 4.0]),
        concentration=np.array([0.0, 1.0, 0.5, 0.2]),
        normals=np.zeros((4, 3)),
        bins=np.zeros((4, 2), np.uint64),
        sum=np.zeros((4, 3)),
        products=np.zeros((4, 6)),
        keyframes=9,
    )
    # Unseen: nothing. One side: s itself. Two sides: e^0.5 s. Much: no more than 1.
    np.testing.assert_allclose(gaussian_confidence(seen), [0.0, 0.3, 0.3 * np.exp(0.5), 1.0])


@pytest.fixture(scope="module")
def wall() -> Mapper:
    """A wall in the plane x = 2, mapped once from the origin: s = (1 - d / 5) cos < 1, so not yet surely known."""
    rgb = np.random.default_rng(1).integers(60, 200, (36, 64, 3)).astype(np.uint8)
    mapper = Mapper(MapperConfig(iterations=20), np.random.default_rng(0))
    mapper.observe(Frame(rgb, np.full((36, 64), 2.0, np.float32), look_along(np.zeros(3), FORWARD), CAMERA))
    return mapper


def context(mapper: Mapper, poses: list, *, state: int = FREE) -> FeatureContext:
    volume = VoxelVolume(np.array([[-3.0, -3, -2], [3, 3, 2]]))
    volume.state[:] = state
    return FeatureContext(
        mapper=mapper, volume=volume, planes=None, camera=CAMERA.resized(32, 18), bounds=np.zeros((2, 3)),
        coverage_alpha=0.5, max_range=10.0, world_from_camera=np.stack(poses),
    )  # fmt: skip


def test_doubt_of_a_wall_falls_with_every_look(wall: Mapper) -> None:
    straight = look_along(np.zeros(3), FORWARD)
    away = look_along(np.zeros(3), -FORWARD)
    first, nothing = evaluate_features(("confidence",), context(wall, [straight, away]))[:, 0]
    # Away from the map every pixel is unseen: 2.5 m of 5.
    assert nothing == pytest.approx(0.5)
    # In the middle of the wall C = 0.6, towards the corners less: between 0.4 and 1 of 2 m of 5.
    assert 0.4 * 0.4 < first < 0.4
    again = Frame(wall.keyframes[0].rgb, wall.keyframes[0].depth, straight, CAMERA)
    looks = [first]
    for _ in range(2):
        wall._store.append(again, new_share=0.0)
        looks.append(evaluate_features(("confidence",), context(wall, [straight]))[0, 0])
    assert looks[0] > looks[1] > looks[2]


@pytest.mark.parametrize(
    ("alpha", "metres", "doubt"),
    [
        (0.7, 4.0, 0.24),  # C = 0.7, since the confidence 1 is blended over 0
        (0.3, 1.0, 0.14),  # any Gaussian in a pixel is surface
        (0.7, 5.1, 0.0),
        (0.0, 1.0, 0.5),
    ],
)
def test_doubt_of_a_pixel_by_hand(monkeypatch: pytest.MonkeyPatch, alpha: float, metres: float, doubt: float) -> None:
    monkeypatch.setattr(features, "view_directions", lambda mapper: None)
    monkeypatch.setattr(features, "gaussian_confidence", lambda seen: np.ones(1))
    monkeypatch.setattr(features, "blended", lambda context, values: context.alpha * values[0])
    filled = np.full((1, 18, 32), alpha, np.float32)
    mapper = SimpleNamespace(render_depth_alpha=lambda camera, poses: (metres * filled, filled))
    step = context(mapper, [look_along(np.zeros(3), FORWARD)])  # type: ignore[arg-type]
    assert evaluate_features(("confidence",), step)[0, 0] == pytest.approx(doubt, rel=1e-6)


def test_unexplored_space_outweighs_doubt(wall: Mapper) -> None:
    poses = [look_along(np.zeros(3), FORWARD), look_along(np.zeros(3), -FORWARD)]
    known, unknown = (
        evaluate_features(("confidence", "unexplored"), context(wall, poses, state=s)) for s in (FREE, UNKNOWN)
    )
    assert not known[:, 1].any()
    np.testing.assert_allclose(unknown[:, 0], known[:, 0] + 1000 * unknown[:, 1], rtol=1e-5)
    assert 1000 * unknown[0, 1] > 50 * known[:, 0].max()
