"""Next Best Sense: the weighted sum, and that its depth term tells what colours cannot."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.splatting.fisher import DIAGONAL, depth_information


def depth_gain(context, pose) -> float:
    """I_depth of one view, term by term: means, log-scales and logits in their own units."""
    gaussians = context.mapper.map
    known = np.zeros((gaussians.count, 24))
    for frame in context.mapper.keyframes:
        seen = depth_information(gaussians.parameters, gaussians.count, context.camera, frame.world_from_camera)
        known[seen.indices] += seen.numbers[:, :24]
    view = depth_information(gaussians.parameters, gaussians.count, context.camera, pose)
    total = 0.0
    for columns in (DIAGONAL[:3], DIAGONAL[3:], [21]):
        entries = known[:, columns]
        of_each = entries.mean(axis=1)
        unit = np.median(of_each[of_each > 0])
        total += (view.numbers[:, columns] / (entries[view.indices] + 0.01 * unit)).sum()
    return total / gaussians.count


def test_a_tenth_of_the_colours_and_the_depth(two_walls, looks) -> None:
    context = two_walls.context(*looks)
    colours, both = evaluate_features(("fisherrf", "next_best_sense"), context).T
    expected = [0.1 * colour + depth_gain(context, pose) for colour, pose in zip(colours, looks)]
    assert both == pytest.approx(expected, rel=1e-4)
    assert both[2] == 0.0 < both[0] < both[1]  # nothing is mapped in the north; the east is known better


def test_the_depth_is_known_whatever_the_colours(two_walls, looks) -> None:
    def of_depth() -> np.ndarray:
        colours, both = evaluate_features(("fisherrf", "next_best_sense"), two_walls.context(*looks)).T
        return both - 0.1 * colours

    before = of_depth()
    two_walls.mapper.map.parameters[11:] *= 0.1  # pale; H of the colours falls to a hundredth
    assert of_depth() == pytest.approx(before, abs=1e-5) and before[1] > 0.0


def test_with_coverage_the_unseen_north_is_first(two_walls, looks) -> None:
    (with_coverage,) = evaluate_features(("next_best_sense_cov",), two_walls.context(*looks)).T
    assert with_coverage.argmax() == 2
