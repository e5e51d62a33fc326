"""ActiveGAMER's gain: any opacity covers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.geometry import PinholeCamera


def test_a_pixel_is_covered_by_however_little_opacity() -> None:
    depth = np.zeros((3, 4, 8), np.float32)
    alpha = np.zeros_like(depth)
    depth[1, :3], alpha[1, :3] = 0.02, 0.01  # a veil at 2 m over three of four rows
    depth[2], alpha[2] = 2.0, 1.0
    context = FeatureContext(
        mapper=SimpleNamespace(render_depth_alpha=lambda camera, poses: (depth, alpha)),
        volume=None,
        planes=None,
        camera=PinholeCamera.from_size(8, 4),
        bounds=np.zeros((2, 3)),
        coverage_alpha=0.5,
        max_range=5.0,
        world_from_camera=np.tile(np.eye(4), (3, 1, 1)),
    )  # fmt: skip
    # The confident coverage of `pixel` does not count the veil.
    table = evaluate_features(("uncovered", "pixel"), context)
    np.testing.assert_allclose(table, [[1.0, 1.0], [0.25, 1.0], [0.0, 0.0]])
