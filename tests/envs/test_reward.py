"""Which surface samples a depth image counts as seen, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.reward import RewardConfig, SurfaceCoverage, reward_terms
from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera

CAMERA = PinholeCamera.from_size(40, 20)


def test_a_sample_is_seen_where_the_depth_agrees() -> None:
    points = np.array(
        [
            [0.0, 0.0, 2.0],  # on the wall
            [0.0, 0.0, 2.1],  # behind it by more than 5 cm + 2 cm
            [0.0, 0.0, 1.5],  # in front of it
            [0.0, 0.0, -2.0],  # behind the camera
            [9.0, 0.0, 2.0],  # outside the image
            [1.0, 0.0, 2.0],  # where the sensor returned nothing
        ]
    )
    coverage = SurfaceCoverage(points, RewardConfig())
    depth = np.full((20, 40), 2.0, np.float32)
    depth[:, 25:] = 0.0
    coverage.add(depth, CAMERA, np.eye(4))
    np.testing.assert_array_equal(coverage.seen, [True, False, False, False, False, False])
    assert coverage.share == pytest.approx(1 / 6)
    coverage.add(np.full((20, 40), 1.5, np.float32), CAMERA, np.eye(4))
    np.testing.assert_array_equal(coverage.seen, [True, False, True, False, False, False])


def test_weights_are_numbers_and_the_noise_is_a_switch() -> None:
    assert RewardConfig(noise_free=True).noise_free
    for wrong in ({"noise_free": 1.0}, {"coverage": True}, {"path": float("nan")}):
        with pytest.raises(InputError):
            RewardConfig(**wrong)


def test_what_was_seen_stays_seen_and_order_does_not_matter(rng: np.random.Generator) -> None:
    points = rng.uniform(-3, 3, (500, 3))
    depths = [np.full((20, 40), z, np.float32) for z in (1.0, 1.5, 2.5)]
    shares = []
    for order in ((0, 1, 2), (2, 0, 1)):
        coverage = SurfaceCoverage(points, RewardConfig())
        grown = [coverage.share]
        for index in order:
            coverage.add(depths[index], CAMERA, np.eye(4))
            grown.append(coverage.share)
        assert grown == sorted(grown)
        shares.append(coverage.share)
    assert shares[0] == shares[1] > 0


def test_terms_by_hand() -> None:
    terms = reward_terms(RewardConfig(), share_gained=0.1, metres=3.0, invalid=True)
    assert terms == {
        "reward/coverage": pytest.approx(2.0),
        "reward/path": pytest.approx(-0.03),
        "reward/invalid": pytest.approx(-0.05),
    }
