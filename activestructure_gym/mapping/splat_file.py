"""Gaussian maps as ``.splat``, the format of antimatter15/splat that web viewers load as it comes.

No header; 32 bytes per Gaussian: mean 3 x float32, standard deviations 3 x float32 in metres, RGB and opacity
4 x uint8, unit quaternion wxyz 4 x uint8 as 128 + 128 q. Those that matter most come first, so that a viewer can show
something before it has everything: opacity times volume. Colour and shape lose what 8 bits cannot hold (up to 0.4 % of
a colour, a degree); PLY keeps them.
"""

from __future__ import annotations

import os

import numpy as np

from activestructure_gym.files import replaced
from activestructure_gym.mapping.gaussian_map import GaussianMap

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quaternion", "u1", 4)])


def write_splat(gaussians: GaussianMap, path: str | os.PathLike[str]) -> None:
    """Write the live Gaussians, whole or not at all."""
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
