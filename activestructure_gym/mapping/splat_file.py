"""Write Gaussian maps as ``.splat`` files, the format of antimatter15/splat that web viewers load progressively.

The file has no header. Each Gaussian has 32 bytes: mean 3 x float32 and standard deviations 3 x float32 in metres, RGB
and opacity 4 x uint8, unit quaternion wxyz 4 x uint8 as 128 + 128 q. Gaussians are sorted by opacity times volume, so
that a viewer shows the largest ones first. Colours and rotations are rounded to 8 bits, with errors of up to 0.4 % and
about 1 degree. PLY files keep full precision.
"""

from __future__ import annotations

import os

import numpy as np

from activestructure_gym.files import replaced
from activestructure_gym.mapping.gaussian_map import GaussianMap

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quaternion", "u1", 4)])


def write_splat(gaussians: GaussianMap, path: str | os.PathLike[str]) -> None:
    """Write the Gaussians to a file. An existing file is replaced only when the new one is complete."""
    records = np.zeros(gaussians.count, RECORD)
    records["mean"], records["scale"] = gaussians.means, gaussians.scales
    records["rgba"][:, :3] = _bytes(255.0 * gaussians.colors)
    records["rgba"][:, 3] = _bytes(255.0 * gaussians.opacities)
    records["quaternion"] = _bytes(128.0 + 128.0 * gaussians.quaternions)
    weight = gaussians.opacities.astype(np.float64) * gaussians.scales.astype(np.float64).prod(axis=1)
    with replaced(path) as file:
        file.write(records[np.argsort(-weight, kind="stable")].tobytes())


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
