"""What the information gains share: units, the observed share, the sum with coverage."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features.information import _Trained, adaptive, observed_share, share_below, trained, units
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN


def test_units_are_medians_of_what_is_known(hand_made) -> None:
    assert units(hand_made) == pytest.approx([4.0, 9.0, 2.0, 5.0])
    known = np.concatenate([trained(hand_made)] * 2 + [np.zeros((3, 24))])
    known[2, 0], known[2, 22] = 1.0, 7.0
    hand_made.mapper.memory[_Trained].of = lambda mapper: known
    # Of two Gaussians: means of (4 + 4 + 4) / 3 and (1 + 4 + 4) / 3, colours of 5 and 7.
    assert units(hand_made) == pytest.approx([3.5, 9.0, 2.0, 6.0])
    hand_made.mapper.memory[_Trained].of = lambda mapper: np.zeros((3, 24))
    assert units(hand_made) == pytest.approx([1.0] * 4)


def test_the_observed_share_is_that_of_the_window_around_the_agent(two_walls) -> None:
    volume = two_walls.volume
    context = two_walls.context(np.eye(4))
    two_walls.know(UNKNOWN)
    assert observed_share(context) == 0.0
    volume.state[: volume.shape[0] // 2] = FREE
    volume.state[volume.shape[0] // 2, 1, 1] = OCCUPIED
    assert observed_share(context) == pytest.approx(0.5, abs=0.02)
    # Near the border of the volume there is less of a window.
    two_walls.mapper.keyframes[-1].world_from_camera[:3, 3] = [-5.0, 0.0, 0.0]
    assert observed_share(context) == 1.0


def test_a_room_that_is_known_to_its_walls_is_wholly_observed(two_walls) -> None:
    context, volume = two_walls.context(np.eye(4)), two_walls.volume
    two_walls.know(UNKNOWN)
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    assert observed_share(context) == 1.0  # the voxels around the workspace stay unknown for ever


def test_what_a_ray_went_through_is_observed_whether_it_is_free_or_not(two_walls) -> None:
    context = two_walls.context(np.eye(4))
    share = observed_share(context)
    two_walls.volume.weight[:] = 0
    assert share > 1.3 * observed_share(context) > 0.0


def test_quality_counts_by_its_rank_as_much_as_is_observed(two_walls) -> None:
    context = two_walls.context(np.eye(4))
    two_walls.know(UNKNOWN)
    coverage, quality = np.array([0.3, 0.15, 0.0, 0.0]), np.array([0.0, 5.0, 1000.0, 5.0])
    assert adaptive(context, coverage, quality) == pytest.approx([1.0, 0.5, 0.0, 0.0])
    two_walls.know(FREE)
    assert adaptive(context, coverage, quality) == pytest.approx([1.0, 1.25, 1.0, 0.75])
    assert adaptive(context, coverage, 1e-9 * quality) == pytest.approx([1.0, 1.25, 1.0, 0.75])
    # Where hardly anything is left to cover, the best of it no longer counts as much as the best of the other.
    assert adaptive(context, coverage / 30, quality) == pytest.approx([0.2, 0.85, 1.0, 0.75])
    assert adaptive(context, coverage, 0.0 * quality) == pytest.approx([1.0, 0.5, 0.0, 0.0])
    assert share_below(np.zeros(0)).shape == (0,)
