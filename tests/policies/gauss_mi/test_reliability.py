"""The reliability of Gaussians by hand: directions, votes, and who follows whom."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.policies.gauss_mi.reliability import (
    LIMIT,
    DirectionalReliability,
    direction_shares,
    pixel_votes,
)
from activestructure_gym.sensors import Frame
from activestructure_gym.splatting.cpu import Rendering

CAMERA = PinholeCamera.from_size(32, 24)


def frame(colour, depth=2.0):
    picture = np.full((24, 32, 3), colour, np.uint8)
    return Frame(picture, np.full((24, 32), depth, np.float32), look_along(np.zeros(3), np.array([1.0, 0, 0])), CAMERA)


def mapped(colour):
    """A Gaussian every two pixels of the wall: those are 12.5 cm apart."""
    mapper = Mapper(MapperConfig(seed_spacing=0.24, seed_footprint=0.6), np.random.default_rng(0))
    mapper.observe(frame(colour), iterations=0)
    return mapper


def test_shares_of_the_four_directions():
    eye = np.array([1.0, 1.0, 0.0])
    means = eye + np.array([[2.0, 0, 0], [0, -3, 0], [-3, 4, 0], [0, 0, 1], [1, 2, 2]])
    expected = [[1, 0, 0, 0], [0, 0, 0, 1], [0, 0.8, 0.6, 0], [0, 0, 0, 0], [1 / 3, 2 / 3, 0, 0]]
    assert direction_shares(means, eye) == pytest.approx(np.array(expected), abs=1e-12)


def test_votes_of_pixels_by_hand():
    seen = frame(51, depth=2.0)  # .2
    seen.depth[0, 0] = 0.0
    color, depth = np.full((24, 32, 3), 0.2, np.float32), np.full((24, 32), 2.0, np.float32)
    color[0, 0], color[0, 1], depth[0, 2], color[0, 3] = 1.0, 0.5, 2.4, 1.2
    seen.rgb[0, 4], depth[0, 5], seen.rgb[0, 5] = 0, 2.4, 0
    votes = pixel_votes(seen, Rendering(color, depth, np.ones((24, 32), np.float32)))
    assert votes[1, 0] == pytest.approx(-np.log(1e-4), rel=1e-5)  # nothing wrong
    assert votes[0, 0] == pytest.approx(-np.log(1e-4), rel=1e-5)  # no measured depth: whatever the colour
    assert votes[0, 4] == pytest.approx(-np.log(1e-4), rel=1e-5)  # black: no colour counts, but the depth does
    assert votes[0, 5] == pytest.approx(votes[0, 2], rel=1e-5)
    assert votes[0, 1] == pytest.approx(-np.log(1.7 * 0.95 * 0.3), rel=1e-5)
    assert votes[0, 2] == pytest.approx(-np.log(1.7 * 0.05 * 0.4), rel=1e-4)
    assert votes[0, 3] == pytest.approx(-np.log(1.7 * 0.95 * 1.0), rel=1e-5) and votes[0, 3] < 0


def test_a_hole_in_the_map_is_an_error() -> None:
    """The code renders over white and does not divide the depth by alpha."""
    seen = frame(26, depth=3.0)
    for alpha, expected in ((0.3, -np.log(1.7 * (0.95 * 0.7 * (1 - 26 / 255) + 0.05 * 0.7 * 3))), (1.0, -np.log(1e-4))):
        filled = np.full((24, 32), alpha, np.float32)
        shown = Rendering(filled[..., None] * np.float32(26 / 255) * np.ones(3, np.float32), 3.0 * filled, filled)
        assert pixel_votes(seen, shown) == pytest.approx(np.full((24, 32), expected), rel=1e-3)


def test_a_contradicted_gaussian_remembers_the_order_of_its_votes() -> None:
    """Votes of +10 and -10 leave -log r = 1.164 nats, and -10 and +10 0.374; never seen is 0.693."""
    mapper = mapped(60)
    middle = np.linalg.norm(mapper.map.means[:, 1:], axis=1) < 0.3
    agrees, errs = frame(60), frame(255, depth=4.0)
    surprises = []
    for frames in ([agrees, errs], [errs, agrees]):
        log_odds = DirectionalReliability(mapper.map).update(frames)[middle, 0]
        surprises.append(np.logaddexp(0.0, -log_odds))
    assert surprises[0] == pytest.approx(np.full(middle.sum(), 1.164), abs=1e-3)
    assert surprises[1] == pytest.approx(np.full(middle.sum(), 0.374), abs=1e-3)


def test_a_look_speaks_for_its_own_direction_and_errors_speak_against_it():
    mapper = mapped(60)
    agreeing = DirectionalReliability(mapper.map).update(mapper.keyframes).copy()
    middle = np.linalg.norm(mapper.map.means[:, 1:], axis=1) < 0.5
    assert (agreeing[middle, 0] > 5.0).all() and agreeing.max() <= LIMIT
    assert (agreeing[:, 2] == 0.0).all()  # nobody has looked towards -x
    wrong = DirectionalReliability(mapper.map).update([frame(255, depth=4.0)])
    assert (wrong[middle, 0] < -5.0).all() and wrong.min() >= -LIMIT


def test_every_keyframe_votes_once_and_gaussians_keep_their_votes():
    mapper = mapped(60)
    reliability = DirectionalReliability(mapper.map)
    first = reliability.update(mapper.keyframes).copy()
    assert np.array_equal(reliability.update(mapper.keyframes), first)
    names = mapper.map.ids[: mapper.map.count].copy()
    mapper.map.keep(np.arange(mapper.map.count) % 3 != 0)
    mapper.map.append(np.zeros((14, 5), np.float32))
    after = reliability.update(mapper.keyframes)
    left = mapper.map.ids[: mapper.map.count - 5]
    assert np.array_equal(after[:-5], first[np.searchsorted(names, left)])
    assert (after[-5:] == 0.0).all()
    with pytest.raises(ValueError, match="at least the 1 of the last call, got 0"):
        reliability.update([])
