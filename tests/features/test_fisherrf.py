"""FisherRF by hand, and what it is blind to."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.features.fisherrf import fisherrf
from activestructure_gym.features.information import trained
from activestructure_gym.splatting.fisher import DIAGONAL, view_information


def test_by_hand(hand_made) -> None:
    # Mean (3) and logit (1) of a known and of an unknown Gaussian, in units; per Gaussian of the map.
    first = 4 / 1.01 + 4 / 0.01
    # One more unit of three log-scales and three colours.
    assert fisherrf(hand_made) == pytest.approx([first / 2, (10 / 1.01 + 10 / 0.01) / 2])


def test_against_the_sum_over_all_parameters(two_walls, looks) -> None:
    context, gaussians = two_walls.context(*looks), two_walls.mapper.map
    known = trained(context)
    groups = [(DIAGONAL[:3], 1), (DIAGONAL[3:], 1), ([21], 1), ([22], 3)]
    expected = []
    for pose in looks:
        (view,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose)
        total = 0.0
        for columns, times in groups:
            entries = known[:, columns]
            of_each = entries.mean(axis=1)
            unit = np.median(of_each[of_each > 0])
            ratios = view.numbers[:, columns] / (entries[view.indices] + 0.01 * unit)
            total += times * ratios.sum()
        expected.append(total / gaussians.count)
    assert evaluate_features(("fisherrf",), context)[:, 0] == pytest.approx(expected, rel=1e-5)


def test_blind_to_unseen_space_alone_but_not_with_coverage(two_walls, looks) -> None:
    pure, whole, holes = evaluate_features(("fisherrf", "fisherrf_cov", "hole_area"), two_walls.context(*looks)).T
    assert pure[2] == 0.0 < pure[0] < pure[1]  # north has no Gaussians; the east wall is known better
    assert whole[2] == pytest.approx(1.0) and holes.argmax() == 2
    assert whole.argmax() == 2


def test_the_same_view_a_second_time_tells_less(two_walls, looks, frame_of) -> None:
    before = fisherrf(two_walls.context(*looks))
    two_walls.see(frame_of(-np.eye(3)[0]))
    after = fisherrf(two_walls.context(*looks))
    assert after[1] < 0.7 * before[1]


def test_who_else_asks_changes_nothing(two_walls, looks) -> None:
    names = ("fisherrf", "popgs_logdet_cov", "popgs_logdet_block", "fisherrf_cov")
    first = evaluate_features(names, two_walls.context(*looks))
    for column, name in enumerate(names):
        assert np.array_equal(evaluate_features((name,), two_walls.context(*looks))[:, 0], first[:, column])
    assert evaluate_features(names, two_walls.context()).shape == (0, 4)
