"""The median depth of disks on the axis of a camera, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features.median_depth import median_depths
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping.gaussian_map import GaussianMap

CAMERA = PinholeCamera.from_size(40, 24)


@pytest.mark.parametrize(("disks", "depth"), [
    ([(1.0, 0.3), (3.0, 0.95)], 3.0),
    ([(1.0, 0.7), (3.0, 0.95)], 1.0),
    ([(4.0, 0.51)], 4.0),
    ([(3.0, 0.3)], 0.0),
])  # fmt: skip
def test_median_depth_is_the_one_at_which_half_is_seen(disks: list[tuple[float, float]], depth: float) -> None:
    """Disks of (depth, opacity) in front of a camera at the origin that looks along x."""
    block = np.zeros((14, len(disks)), np.float32)
    block[0], opacity = np.transpose(disks)
    block[3], block[7:10], block[10] = 1.0, np.log([[1e-3], [5.0], [5.0]]), np.log(opacity / (1.0 - opacity))
    gaussians = GaussianMap(16)
    gaussians.append(block)
    image = median_depths(gaussians, CAMERA, look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))[None])
    assert image.shape == (1, 24, 40)
    assert image[0, 12, 20] == pytest.approx(depth, rel=1e-3)
