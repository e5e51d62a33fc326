"""Write poses in the format of the TUM RGB-D benchmark, which evo reads ([tum_rgbd], file formats)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from activestructure_gym.files import replaced
from activestructure_gym.geometry.rotations import quaternion_of


def write_tum(numbers: np.ndarray, world_from_camera: np.ndarray, file: Path) -> None:
    """Write a line ``timestamp tx ty tz qx qy qz qw`` per pose; an existing file is replaced when the new is complete.

    Parameters
    ----------
    numbers : numpy.ndarray
        [N] frame numbers, which become the time stamps: a frame has no other time.
    world_from_camera : numpy.ndarray
        [N, 4, 4] poses in metres, camera axes x right, y down, z forward.
    file : pathlib.Path
        The file.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    lines = ["# timestamp tx ty tz qx qy qz qw: world from camera (z forward), world z up, metres; stamps count frames"]
    for number, pose in zip(numbers, world_from_camera):
        w, x, y, z = quaternion_of(pose[:3, :3])
        lines.append(" ".join(repr(float(value)) for value in (number, *pose[:3, 3], x, y, z, w)))
    with replaced(file) as stream:
        stream.write("".join(f"{line}\n" for line in lines).encode())
