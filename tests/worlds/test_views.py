"""Worlds that can capture given poses only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import rotation_angle
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.motion import is_level, levelled
from activestructure_gym.sources.places import directions, looking
from activestructure_gym.views import GivenViews, ViewConfig, without_overlap
from activestructure_gym.worlds import Reliable, StoredCaptures, Views, checked_bounds, checked_views
from activestructure_gym.worlds.simulated_world import SimulatedRobot


class Rail(SimulatedRobot):
    """Slide along a line and turn: 5 positions 0.2 m apart with 8 directions each, all rolled by 5 degrees."""

    def reset(self, seed: int) -> None:
        super().reset(seed)
        start = self._pose[:3, 3]
        towards = np.sign(self.bounds.mean(axis=0)[0] - start[0])
        places = start + np.array([[0.2 * towards * step, 0.0, 0.0] for step in range(5)])
        yaw = np.tile(np.radians(45.0 * np.arange(8)), 5)
        poses = looking(np.repeat(places, 8, axis=0), directions(yaw, np.zeros(40)))
        angle = np.radians(5.0)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        poses[:, :3, :2] = poses[:, :3, :2] @ turn
        self._pose = poses[0]
        self.views = Views(poses, np.full(40, 0.3))
        self.taken: list[np.ndarray] = []

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        level = np.stack([levelled(pose) for pose in self.views.world_from_camera])
        same = np.abs(level - levelled(world_from_camera)).max(axis=(1, 2)) < 1e-9
        assert same.sum() == 1  # only views are asked for
        self._pose = self.views.world_from_camera[int(np.argmax(same))]
        self.taken.append(self._pose)
        return self._sensor.capture(self._pose)


def test_only_the_views_are_offered_and_captured() -> None:
    world = Rail("box", width=64, height=36)
    config = {"views.max_revisits": 3, "keyframe_every": 2}
    env = ReconstructionEnv(world, preset="fast", frame_budget=60, config=config)
    env.reset(seed=0)
    episode = env.reconstruction
    level = np.stack([levelled(pose) for pose in world.views.world_from_camera])
    for _ in range(12):
        table = episode.candidates
        assert is_level(table.world_from_camera).all()
        assert (table.revisit | (table.ids >= 0)).all() and len(table) > 10
        np.testing.assert_array_equal(table.world_from_camera[~table.revisit], level[table.ids[~table.revisit]])
        new = {pose.tobytes() for pose in table.world_from_camera[~table.revisit]}
        assert not new & {levelled(pose).tobytes() for pose in world.taken}  # each is offered as new once
        row = len(table) - 1 if episode.decisions % 2 else len(table) // 2  # a revisit is the last row
        _, _, _, truncated, info = env.step(row)
        assert info["reached"] or truncated
        if truncated:
            break
    assert len(world.taken) == len(episode.keyframe_indices) > 8
    for pose, index in zip(world.taken, episode.keyframe_indices):
        np.testing.assert_allclose(episode.trajectory[index], pose, atol=1e-12)  # the frame's own pose, with its roll
    env.close()


def test_views_are_those_after_the_reset(tmp_path: Path) -> None:
    rail = Rail("box", width=64, height=36)
    for world in (Reliable(rail), StoredCaptures(tmp_path, rail)):
        world.reset(0)
        before = world.views.world_from_camera
        world.reset(5)
        np.testing.assert_array_equal(world.views.world_from_camera[0], world.start.pose)
        assert not np.array_equal(world.views.world_from_camera, before)


def test_a_source_of_other_poses_is_refused() -> None:
    env = ReconstructionEnv(
        Rail("box", width=64, height=36), preset="fast", config={"views.stages": [["around?rows=32"]]}
    )
    with pytest.raises(InputError, match="given views only, and the candidate source 'around.rows=32' proposes others"):
        env.reset(seed=0)
    env.close()


def test_views_are_checked() -> None:
    bounds = checked_bounds([[0, 0, 0], [2, 2, 2]])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = 1.0, 3.0, 2.0
    kept = checked_views(Views(poses, np.array([0.1, 0.2, 0.3])), bounds)
    assert kept.world_from_camera[:, 0, 3].tolist() == [1.0, 2.0] and kept.free_radius.tolist() == [0.1, 0.3]
    with pytest.raises(InputError, match="none of the 1 views is inside"):
        checked_views(Views(poses[1:2], np.ones(1)), bounds)
    with pytest.raises(InputError, match="view 2 must be a rigid motion"):
        checked_views(Views(np.stack([*poses[:2], 2 * np.eye(4)]), np.ones(3)), bounds)
    for radius in (-0.1, np.nan):
        with pytest.raises(InputError, match=f"the free_radius of a view must be 0 m or more, got {radius}"):
            checked_views(Views(poses, np.array([0.1, radius, 0.3])), bounds)
    for wrong in (poses[0], poses[:0]):
        with pytest.raises(InputError, match="views are poses"):
            Views(wrong, np.ones(3))


def test_the_nearest_view_by_position_and_rotation() -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.09, 0.0, 0.0], [1.0, 0.0, 0.0]])
    poses = looking(places, directions(np.radians([0.0, 9.0, 0.0]), np.zeros(3)))
    pool = GivenViews(poses, ViewConfig(), 0)
    here = poses[0].copy()
    here[0, 3] = 0.06  # 0.6 of a step from the first one; from the second 0.3 of a step, but 0.9 of a turn
    np.testing.assert_array_equal(pool.at(here, metres=0.1, degrees=10.0), poses[0])
    assert pool.at(here, metres=0.02, degrees=10.0) is None
    pool.mark_visited(poses[1])
    assert len(pool) == 2
    np.testing.assert_array_equal(pool.at(poses[1], metres=0.1, degrees=10.0), poses[1])  # visited ones too
    assert rotation_angle(poses[0], poses[1]) > np.radians(8.9)


def test_spheres_within_others_are_left_out() -> None:
    centres = np.array([[0.0, 0, 0], [0.04, 0, 0], [0.04, 0, 0], [0.5, 0, 0], [0.1, 0, 0]])
    radii = np.array([0.3, 0.3, 0.4, 0.3, 0.2])
    assert without_overlap(centres, radii, slack=0.05) == [0, 2, 3]
    assert without_overlap(centres, radii, slack=0.0) == [0, 1, 2, 3]
