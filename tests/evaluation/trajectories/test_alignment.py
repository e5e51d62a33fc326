"""Alignment and errors of trajectories, by hand and against SciPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.alignment import matched, trajectory_errors, umeyama
from activestructure_gym.evaluation.trajectories.formats import read_recorded


def moved_by(positions: np.ndarray) -> np.ndarray:
    """The positions at half the size, after a quarter turn about z and a move by (1, 2, 3)."""
    return 0.5 * positions @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]).T + [1, 2, 3]


def test_a_similarity_by_hand_is_found() -> None:
    corners = np.array([[0.0, 0, 0], [2, 0, 0], [0, 4, 0], [0, 0, 6]])
    found = umeyama(corners, moved_by(corners), with_scale=True)
    assert found.scale == pytest.approx(0.5) and found.translation == pytest.approx([1, 2, 3])
    np.testing.assert_allclose(found.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, 3] = corners
    aligned = found.moved(poses)
    np.testing.assert_allclose(aligned[:, :3, 3], moved_by(corners), atol=1e-12)
    np.testing.assert_allclose(aligned[2, :3, :3], found.rotation)  # the scale is not in the rotation
    flat = corners[:3]  # in a plane, which a mirror would fit as well
    assert np.linalg.det(umeyama(flat, moved_by(flat), with_scale=True).rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_rotation_is_that_of_scipy(rng: np.random.Generator, mirrored: bool) -> None:
    source = rng.normal(size=(50, 3))
    target = source @ Rotation.random(random_state=3).as_matrix().T + rng.normal(scale=0.1, size=(50, 3)) + 4.0
    if mirrored:  # a rotation is the answer even where a reflection is nearer
        target[:, 0] *= -1
    wanted, residual = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    for with_scale in (False, True):
        found = umeyama(source, target, with_scale=with_scale)
        np.testing.assert_allclose(found.rotation, wanted.as_matrix(), atol=1e-9)
    rigid = umeyama(source, target, with_scale=False)
    left = np.linalg.norm(source @ rigid.rotation.T + rigid.translation - target)
    assert left == pytest.approx(residual) and rigid.scale == 1.0
    scaled = source @ found.rotation.T
    best = ((target - target.mean(axis=0)) * (scaled - scaled.mean(axis=0))).sum() / np.var(source, axis=0).sum() / 50
    assert found.scale == pytest.approx(best), "the scale of least squares for this rotation"


@pytest.mark.parametrize("positions", [np.eye(3)[:2], np.linspace([0, 0, 0], [1, 2, 3], 9), np.ones((5, 3))])
def test_positions_on_a_line_determine_no_rotation(positions: np.ndarray) -> None:
    with pytest.raises(InputError, match="matched positions are on a line or fewer than 3"):
        umeyama(positions, positions, with_scale=False)


def test_poses_match_by_the_nearest_time_stamp_or_by_index() -> None:
    ours, theirs = matched(4, np.array([0.0, 0.1, 0.2, 0.3]), 5, np.array([0.005, 0.09, 0.105, 0.25, 0.31]))
    assert (ours.tolist(), theirs.tolist()) == ([0, 1, 3], [0, 2, 4])
    assert matched(3, None, 3, np.zeros(3))[1].tolist() == [0, 1, 2]
    with pytest.raises(InputError, match="has 3 poses and its reference 4: equal counts"):
        matched(3, None, 4, np.arange(4.0))
    with pytest.raises(InputError, match=r"1 time stamps .* \(0.000 to 5.000 s\) .* \(0.001 to 9.000 s\)"):
        matched(2, np.array([0.0, 5.0]), 2, np.array([0.001, 9.0]))


def test_errors_by_hand() -> None:
    reference = np.tile(np.eye(4), (3, 1, 1))
    reference[:, 0, 3] = [0, 1, 2]
    poses = reference.copy()
    poses[:, 1, 3] = [0, 0, 0.3]  # the last position is 0.3 m off
    poses[1:, :3, :3] = Rotation.from_euler("z", 6, degrees=True).as_matrix()
    errors = trajectory_errors(poses, reference)
    assert errors["ate_m"] == pytest.approx(0.3 / np.sqrt(3))
    assert errors["rpe_deg"] == pytest.approx(6 / np.sqrt(2)), "the first move turns by 6 degrees, the second by 0"
    turned = Rotation.from_euler("z", -6, degrees=True).apply([1.0, 0.3, 0]) - [1, 0, 0]
    assert errors["rpe_m"] == pytest.approx(np.linalg.norm(turned) / np.sqrt(2)) and errors["poses_matched"] == 3
    assert trajectory_errors(reference, reference)["ate_m"] == 0.0
    assert trajectory_errors(reference[:1], reference[:1])["rpe_m"] == 0.0


def test_the_drift_of_a_real_trajectory(shared: Path) -> None:
    """A known noise on the ground truth of TUM's freiburg1_xyz, moved, at another scale and with every fifth pose."""
    truth = read_recorded(shared / "data" / "trajectories" / "freiburg1_xyz-groundtruth.txt")
    assert truth.stamps is not None
    rng = np.random.default_rng(0)
    estimate = truth.poses[::5].copy()
    noise = rng.normal(scale=0.01, size=(len(estimate), 3))
    estimate[:, :3, 3] = moved_by(estimate[:, :3, 3] + noise)
    ours, theirs = matched(len(estimate), truth.stamps[::5] + 0.004, len(truth.poses), truth.stamps)
    assert len(ours) == len(estimate) and (theirs == 5 * ours).mean() > 0.95
    found = umeyama(estimate[ours, :3, 3], truth.poses[5 * ours, :3, 3], with_scale=True)
    errors = trajectory_errors(found.moved(estimate)[ours], truth.poses[5 * ours])
    assert found.scale == pytest.approx(2.0, rel=2e-2)
    assert errors["ate_m"] == pytest.approx(np.sqrt((noise**2).sum(axis=1).mean()), rel=2e-2)
