"""POp-GS by hand, its laws, and why two of its criteria are negative controls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.geometry import look_along
from activestructure_gym.policies.popgs import features as popgs
from activestructure_gym.policies.popgs.features import popgs_cov_trace, popgs_info_trace, popgs_logdet, popgs_min_eig

SUMS = (popgs_logdet, popgs_cov_trace, popgs_info_trace)


def test_by_hand(hand_made) -> None:
    # Of a known Gaussian (1 unit + lambda) and an unknown one (lambda): the first view tells 1 unit of three means.
    known, unknown = np.log(1 + 1 / 1.01), np.log(1 + 1 / 0.01)
    assert popgs_logdet(hand_made) == pytest.approx([3 * (known + unknown) / 2, 6 * (known + unknown) / 2])
    known, unknown = 1 / 1.01 - 1 / 2.01, 1 / 0.01 - 1 / 1.01
    assert popgs_cov_trace(hand_made) == pytest.approx([3 * (known + unknown) / 2, 6 * (known + unknown) / 2])
    assert popgs_info_trace(hand_made) == pytest.approx([3.0, 6.0])
    # The least entries are those of the unknown Gaussian; the first view leaves its log-scales as they were.
    assert popgs_min_eig(hand_made) == pytest.approx([0.0, 1.0], abs=1e-9)


def test_the_least_entry_is_that_of_the_whole_map(hand_made, monkeypatch) -> None:
    views = popgs.informed_views(hand_made)
    only_known = [replace(view, indices=view.indices[:1], numbers=view.numbers[:1]) for view in views]
    monkeypatch.setattr(popgs, "informed_views", lambda context: iter(only_known))
    # Views of the first Gaussian alone: its own least entry grows, that of the map does not.
    assert popgs_min_eig(hand_made) == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("gain", SUMS)
def test_never_negative_and_none_for_what_shows_nothing(gain, two_walls, looks) -> None:
    found = gain(two_walls.context(*looks))
    assert (found[:2] > 0).all() and found[2] == 0.0


@pytest.mark.parametrize("gain", [popgs_logdet, popgs_cov_trace])
def test_what_is_known_better_tells_less(gain, two_walls, looks, frame_of) -> None:
    last = gain(two_walls.context(*looks))
    assert last[0] < last[1]  # the east wall was seen three times, the west wall once
    for _ in range(3):
        two_walls.see(frame_of(np.array([-1.0, 0.0, 0.0])))
        found = gain(two_walls.context(*looks))
        assert found[1] < 0.9 * last[1]
        last = found


def test_log_determinants_of_views_one_after_the_other_add_up(hand_made) -> None:
    # What two equal views tell together is what the first tells and what then is left for the second.
    both, first, then = np.log(1 + 2 / 1.01), np.log(1 + 1 / 1.01), np.log(1 + 1 / 2.01)
    assert both == pytest.approx(first + then) and then < first


def test_the_trace_of_the_information_likes_what_is_seen_and_near(two_walls, looks) -> None:
    # It does not ask what is known: both walls alike, though one was seen three times; and the nearer, the better.
    nearer = look_along(np.array([1.2, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    context = two_walls.context(*looks, nearer)
    info, logdet = (evaluate_features((f"popgs_{name}",), context)[:, 0] for name in ("info_trace", "logdet"))
    assert info[0] > 0.85 * info[1] and info.argmax() == 3
    assert logdet[0] < 0.75 * logdet[1] and logdet.argmax() == 1


def test_the_least_entry_of_a_real_map_is_the_same_whatever_is_seen(two_walls, looks) -> None:
    found = popgs_min_eig(two_walls.context(*looks))
    assert found[2] == 0.0  # north shows nothing at all
    assert found == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
