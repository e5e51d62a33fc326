"""TUM files are read as evo reads them, and by our own reader."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.export import write_tum
from activestructure_gym.evaluation.trajectories.formats import read_poses


def test_the_lines_hold_time_position_and_quaternion(run: Run, tmp_path: Path) -> None:
    poses = run.trajectory["world_from_camera"]
    write_tum(np.arange(len(poses)), poses, tmp_path / "path.txt")
    with open(tmp_path / "path.txt") as file:
        rows = list(csv.reader((line for line in file if not line.startswith("#")), delimiter=" "))
    numbers = np.array(rows, float)
    assert numbers.shape == (len(poses), 8) and numbers[:, 0].tolist() == list(range(len(poses)))
    np.testing.assert_array_equal(numbers[:, 1:4], poses[:, :3, 3])
    np.testing.assert_allclose(Rotation.from_quat(numbers[:, 4:]).as_matrix(), poses[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(read_poses(tmp_path / "path.txt"), poses, atol=1e-12)
