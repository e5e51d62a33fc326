"""Unknown voxels in sight, against counting them one by one."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.features.unexplored import unknown_cells
from activestructure_gym.geometry import PinholeCamera, invert_rigid, look_along
from activestructure_gym.policies.active_gs import ActiveGS
from activestructure_gym.policies.frontier import Frontier
from activestructure_gym.sensors import Frame
from activestructure_gym.volume import FREE, UNKNOWN, VoxelVolume

CAMERA = PinholeCamera.from_size(40, 24)
EYE = np.array([2.03, 2.01, 2.02])
DIRECTIONS = np.array([[1.0, 0, 0], [0, -1.0, 0], [0.6, 0.3, -0.2]])


def context(state: np.ndarray, alpha: float, depth: float, *, max_range: float = 5.0) -> FeatureContext:
    poses = np.stack([look_along(EYE, d / np.linalg.norm(d)) for d in DIRECTIONS])
    size = (len(poses), 24, 40)
    images = np.full(size, alpha * depth, np.float32), np.full(size, alpha, np.float32)
    config = SimpleNamespace(voxel_size=0.1, max_range=max_range)
    return FeatureContext(
        mapper=SimpleNamespace(render_depth_alpha=lambda camera, poses: images),
        volume=SimpleNamespace(state=state, unobserved=state == UNKNOWN, origin=np.zeros(3), config=config),
        planes=None, camera=CAMERA, bounds=np.array([[0.1] * 3, [4.1] * 3]), coverage_alpha=0.5, max_range=10.0,
        world_from_camera=poses,
    )  # fmt: skip


def counted(state: np.ndarray, pose: np.ndarray, reach: float) -> float:
    """Share of the inner voxels that are unknown and have their centre, or their unknown cell's, in sight."""
    unknown = state[1:-1, 1:-1, 1:-1] == UNKNOWN
    voxels = np.argwhere(unknown)
    centres = voxels + 0.5
    for row, voxel in enumerate(voxels):
        corner = voxel // 2 * 2
        if unknown[corner[0] : corner[0] + 2, corner[1] : corner[1] + 2, corner[2] : corner[2] + 2].sum() == 8:
            centres[row] = corner + 1.0
    centres = (centres + 1) * 0.1
    seen = np.c_[centres, np.ones(len(centres))] @ invert_rigid(pose).T
    with np.errstate(divide="ignore", invalid="ignore"):
        u = CAMERA.fx * seen[:, 0] / seen[:, 2] + CAMERA.cx
        v = CAMERA.fy * seen[:, 1] / seen[:, 2] + CAMERA.cy
    inside = (seen[:, 2] > 0) & (u >= 0) & (u < 40) & (v >= 0) & (v < 24) & (seen[:, 2] < reach)
    return inside.sum() / unknown.size


@pytest.mark.parametrize(
    ("alpha", "depth", "reach"), [(0.0, 1.0, 1.7), (1.0, 0.9, 0.9), (0.1, 1.2, 1.2), (1.0, 3.0, 1.7)]
)
def test_the_share_is_counted_up_to_the_surface_or_the_range(alpha: float, depth: float, reach: float) -> None:
    state = np.random.default_rng(3).choice(np.array([UNKNOWN, FREE], np.uint8), (42, 41, 42))
    state[21:] = UNKNOWN
    step = context(state, alpha, depth, max_range=1.7)
    gain = evaluate_features(("unexplored",), step)[:, 0]
    expected = [counted(state, pose, reach) for pose in step.world_from_camera]
    np.testing.assert_allclose(gain, expected, rtol=1e-5)
    assert min(expected) > 0.001


def test_known_space_has_nothing_to_explore_and_what_lies_outside_is_no_workspace() -> None:
    state = np.full((42, 42, 42), UNKNOWN, np.uint8)
    state[1:-1, 1:-1, 1:-1] = FREE
    assert not evaluate_features(("unexplored",), context(state, 0.0, 1.0)).any()
    state[-3:-1, -3:-1, 1:4] = UNKNOWN  # a cell and four voxels more
    centres, counts, total = unknown_cells(context(state, 0.0, 1.0).volume)
    assert (len(centres), sorted(counts.tolist()), total) == (5, [1, 1, 1, 1, 8], 40**3)
    np.testing.assert_allclose(centres[0], [4.0, 4.0, 0.2])
    assert (centres[1:, 2].round(6) == 0.35).all()


@pytest.mark.parametrize("distance", [1.53, 3.53])  # near, and beyond the 2.4 m up to which one look is enough
def test_what_has_been_looked_at_is_explored_though_it_is_not_proven_free(distance: float) -> None:
    camera = PinholeCamera.from_size(160, 96)
    pose = look_along(EYE, np.array([1.0, 0.0, 0.0]))
    volume = VoxelVolume(np.array([[0.0] * 3, [8.0, 4.0, 4.0]]))
    whole = FeatureContext(
        mapper=SimpleNamespace(render_depth_alpha=lambda *_: (wall[None], np.ones_like(wall[None]))),
        volume=volume, planes=None, camera=camera, bounds=np.zeros((2, 3)), coverage_alpha=0.5, max_range=10.0,
        world_from_camera=pose[None],
    )  # fmt: skip
    wall = np.full((96, 160), distance, np.float32)
    before = evaluate_features(("unexplored",), whole)[0, 0]
    volume.integrate(Frame(np.zeros((96, 160, 3), np.uint8), wall, pose, camera))
    after = evaluate_features(("unexplored",), dataclasses.replace(whole))[0, 0]
    assert after < 0.03 * before  # what is left stands at the border of the image
    # What one may move through is another question: in front of the wall it still has to be proven.
    shell = (volume.state == UNKNOWN) & ~volume.unobserved
    assert shell.sum() > 0.05 * before * volume.state.size
    assert not volume.clearance[shell].any()


def test_where_all_has_been_seen_active_gs_goes_by_confidence_and_frontier_by_the_way(two_walls, looks) -> None:
    east, west, _ = looks  # the west wall was seen once, the east wall three times
    gains = evaluate_features(("unexplored", "confidence"), two_walls.context(east, west))
    assert gains[:, 0].max() < 1e-4
    table = np.zeros((2, len(CANDIDATE_COLUMNS)), np.float32)
    table[:, CANDIDATE_COLUMNS.index("path_length")] = [1.0, 1.2]
    chosen = []
    for policy in (Frontier(), ActiveGS()):
        policy.bind(("unexplored", "confidence"))
        chosen.append(
            policy.act({"candidates": table, "candidate_features": gains, "action_mask": np.ones(2, np.int8)})
        )
    assert chosen == [0, 1]
