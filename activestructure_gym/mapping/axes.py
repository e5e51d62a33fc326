"""Rotate a Gaussian map to the axes of other programs: the world here has z up, most splat viewers have y up or y down.

Colours do not depend on the view direction (spherical harmonics of degree 0), so only means and quaternions change.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

import numpy as np

from activestructure_gym.geometry.rotations import quaternion_of, turned
from activestructure_gym.mapping.gaussian_map import MEAN, QUATERNION, GaussianMap

UpInFile = Literal["z", "y", "-y"]
# Rotation matrix from the world's axes to the axes of a file, for each up axis of the file. All rotate about the x
# axis.
FILE_FROM_WORLD: MappingProxyType[UpInFile, np.ndarray] = MappingProxyType(
    {
        "z": np.eye(3),
        "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    }
)


def turned_map(gaussians: GaussianMap, rotation: np.ndarray) -> GaussianMap:
    """Return a copy of the map rotated about the origin by a rotation matrix [3, 3]; its Adam moments are 0."""
    block = gaussians.parameters[:, : gaussians.count].astype(np.float64)
    block[MEAN] = rotation @ block[MEAN]
    block[QUATERNION] = turned(quaternion_of(rotation), block[QUATERNION].T).T
    result = GaussianMap(max(1, gaussians.count))
    result.append(block.astype(np.float32))
    return result
