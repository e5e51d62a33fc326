"""Where two readings of the depth disagree: by hand, and with a Gaussian in front of a wall."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext, evaluate_features
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.policies.activepolicy.features import (  # fmt: skip
    LOG_WEIGHT,
    SENSITIVITY,
    THRESHOLD,
    disagreement,
)
from activestructure_gym.splatting import cpu

CAMERA = PinholeCamera.from_size(40, 24)


def context(disks: list[tuple[float, float, float]]) -> FeatureContext:
    """Disks (depth, opacity, sigma) on the axis of a camera at the origin that looks along x."""
    gaussians = GaussianMap(16)
    block = np.zeros((14, len(disks)), np.float32)
    for k, (depth, opacity, sigma) in enumerate(disks):
        block[0, k], block[3, k], block[7:10, k] = depth, 1.0, np.log([1e-3, sigma, sigma])
        block[10, k] = np.log(opacity / (1 - opacity))
    gaussians.append(block)
    mapper = SimpleNamespace(
        map=gaussians,
        render_depth_alpha=lambda camera, poses: cpu.render_depth_alpha(
            gaussians.parameters, gaussians.count, camera, poses
        ),
    )
    return FeatureContext(
        mapper=mapper, volume=None, planes=None, camera=CAMERA, bounds=np.zeros((2, 3)), coverage_alpha=0.5,
        max_range=10.0, world_from_camera=look_along(np.zeros(3), np.array([1.0, 0.0, 0.0]))[None],
    )  # fmt: skip


def test_disagreement_by_hand() -> None:
    image = np.ones((1, 5, 5))
    np.testing.assert_allclose(disagreement(2 * image, 2 * image, image), 0.0, atol=1e-12)
    apart = disagreement(2.0 * image, 1.8 * image, image)
    k = 1.0 / (1.0 + LOG_WEIGHT * np.log(2.0 / 1.8))
    spread = np.var([2.0, 1.8, 2.0**k * 1.8 ** (1 - k)]) / 4.0
    np.testing.assert_allclose(apart, 0.5 * np.tanh(0.5 * SENSITIVITY * spread))  # flat images: no Laplacian
    edge = 1.8 * image
    edge[0, 2, 2] = 2.0
    bent = disagreement(2.0 * image, edge, image)[0]
    assert bent[2, 2] > 0  # the depths agree, their curvature does not
    assert bent[2, 1] > bent[0, 0]


def test_disagreement_grows_with_the_ratio_and_stays_in_0_to_1() -> None:
    image = np.ones((1, 4, 4))
    values = [disagreement(2.0 * image, factor * 2.0 * image, image)[0, 0, 0] for factor in (1.0, 1.05, 1.1, 1.3, 3.0)]
    assert (np.diff(values) > 0).all()
    assert 0.0 <= values[0] < values[-1] <= 1.0


def test_the_border_of_a_hole_does_not_count_as_uncertain() -> None:
    plate = context([(3.0, 0.99, 0.4)])
    share = float((plate.alpha <= plate.coverage_alpha).mean())
    assert 0.2 < share < 0.98
    assert evaluate_features(("activepolicy",), plate)[0, 0] == pytest.approx(share)


def test_what_is_not_covered_or_veiled_counts_and_a_wall_does_not() -> None:
    nothing, wall, veil = context([(1.0, 0.01, 0.01)]), context([(3.0, 0.99, 5.0)]), context([])
    assert evaluate_features(("activepolicy",), nothing)[0, 0] == 1.0
    assert evaluate_features(("activepolicy",), veil)[0, 0] == 1.0
    assert evaluate_features(("activepolicy",), wall)[0, 0] == 0.0
    # Two layers 2 m apart, each of about half the weight.
    veil = context([(1.0, 0.45, 5.0), (3.0, 0.99, 5.0)])
    assert disagreement(np.array(1.9).reshape(1, 1, 1), np.array(3.0).reshape(1, 1, 1), np.ones((1, 1, 1))) > THRESHOLD
    assert evaluate_features(("activepolicy",), veil)[0, 0] > 0.9
