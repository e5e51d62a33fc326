"""A Gaussian map in other axes: our world has z up, most viewers of splats have y up or down.

The map's colours do not depend on the direction of view (spherical harmonics of degree 0), so only means and
quaternions turn.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

import numpy as np

from activestructure_gym.geometry.rotations import quaternion_of, turned
from activestructure_gym.mapping.gaussian_map import MEAN, QUATERNION, GaussianMap

UpInFile = Literal["z", "y", "-y"]
# File axes from the world's, by what is up in the file; proper rotations about x.
FILE_FROM_WORLD: MappingProxyType[UpInFile, np.ndarray] = MappingProxyType(
    {
        "z": np.eye(3),
        "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    }
)


def turned_map(gaussians: GaussianMap, rotation: np.ndarray) -> GaussianMap:
    """The live Gaussians of a map, turned about the origin by a rotation matrix [3, 3]; without moments."""
    block = gaussians.parameters[:, : gaussians.count].astype(np.float64)
    block[MEAN] = rotation @ block[MEAN]
    block[QUATERNION] = turned(quaternion_of(rotation), block[QUATERNION].T).T
    result = GaussianMap(max(1, gaussians.count))
    result.append(block.astype(np.float32))
    return result
