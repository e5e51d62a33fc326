"""The passive sweep: within reach, within the limits, through every room."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.evaluation.references.sweep import SPACING_M, Layer, sweep
from activestructure_gym.evaluation.running.episode import path_collisions
from activestructure_gym.evaluation.trajectories.motion import motion_report
from activestructure_gym.geometry import look_along
from activestructure_gym.ground_truth import FreeSpace, ground_truth_of
from activestructure_gym.motion import MotionConfig
from activestructure_gym.scenes import load_scene

MOTION = MotionConfig()


def two_rooms() -> FreeSpace:
    """3 x 3 m each, side by side, with a wall of 0.2 m between them and a door of 1 m at its end."""
    clearance = np.full((64, 32, 3), 0.5, np.float32)
    clearance[:, [0, -1]] = clearance[[0, -1]] = 0.0
    clearance[31:33, :21] = 0.0
    return FreeSpace(np.zeros(3), 0.1, clearance, np.full_like(clearance, 1.2), np.zeros((0, 4, 4)))


START = look_along(np.array([0.55, 0.55, 0.15]), np.array([0.0, 1.0, 0.0]))


def test_it_goes_round_the_wall_and_covers_both_rooms() -> None:
    space = two_rooms()
    layer = Layer(space, START[:3, 3], 0.3)
    way = layer.path(START[:3, 3], int(layer._index[55, 5]))  # straight across the wall
    np.testing.assert_allclose(way[-1], [5.55, 0.55, 0.15])
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    through_the_door = 2 * np.hypot(2.5, 2.1 - 0.55)  # to the wall's end and back
    assert through_the_door < length < 1.05 * through_the_door + 0.2
    poses = sweep(space, START, 10_000, MOTION)
    assert (space.clearance_at(poses[:, :3, 3]) > 0).all() and np.ptp(poses[:, 2, 3]) < 1e-12
    free = space.centers(space.free_voxels)[:, :2]
    apart = np.linalg.norm(free[:, None] - poses[None, ::10, :2, 3], axis=-1).min(axis=1)
    assert apart.max() <= SPACING_M
    assert len(poses) > 3 * 36 * len(layer.tour()), "a full turn in each place, on three tours"


def test_frames_cut_it_short_and_change_nothing_of_what_is_before() -> None:
    long, short = (sweep(two_rooms(), START, frames, MOTION) for frames in (400, 90))
    assert len(short) == 90 and len(long) == 400
    assert long[:90].tobytes() == short.tobytes() and (short[0] == START).all()


@pytest.mark.parametrize("spec", ["box", "apartment?rooms=2&seed=1"])
def test_it_keeps_the_limits_of_planners_and_meets_no_wall(spec: str) -> None:
    truth = ground_truth_of(load_scene(spec))
    poses = sweep(truth.free_space, truth.free_space.start_poses[0], 600, MOTION)
    told = motion_report(poses, max_step_m=MOTION.max_step_m, max_turn_deg=MOTION.max_turn_deg)
    assert (told["steps_too_long"], told["turns_too_wide"], path_collisions(truth.scene, poses)) == (0, 0, 0)
