"""Next Best Sense: information pooled for each Gaussian, and that its depth term shows what colours cannot."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features, information
from activestructure_gym.policies.next_best_sense import features
from activestructure_gym.splatting.fisher import DIAGONAL, ViewInformation, depth_information, view_information


def pooled(context, pose) -> np.ndarray:  # [N]
    """0.1 H of the colours plus H of the depth, term by term over all parameters of each Gaussian."""
    gaussians, total = context.mapper.map, np.zeros(context.mapper.map.count)
    (color,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose)
    depth = depth_information(gaussians.parameters, gaussians.count, context.camera, pose)
    for weight, view, colors in ((0.1, color, 3), (1.0, depth, 0)):
        for column, times in (*((entry, 1) for entry in DIAGONAL), (21, 1), (22, colors)):
            total[view.indices] += weight * times * view.numbers[:, column]
    return total


def test_the_sum_of_the_ratios_of_all_gaussians(two_walls, looks) -> None:
    context = two_walls.context(*looks)
    known = sum(pooled(context, frame.world_from_camera) for frame in context.mapper.keyframes)
    least = 0.01 * np.median(known[known > 0])
    found = evaluate_features(("next_best_sense",), context)[:, 0]
    assert found == pytest.approx([(pooled(context, pose) / (known + least)).mean() for pose in looks], rel=1e-4)
    assert found[2] == 0.0 < found[0] < found[1]  # nothing is mapped in the north; the east is known better


@pytest.mark.parametrize(("weight", "expected"), [(0.0, (0.999, 0.010)), (0.1, (1010 / 1011, 20 / 1011))])
def test_what_is_new_of_a_weak_parameter_does_not_outweigh_the_whole(
    weight, expected, two_walls, looks, monkeypatch
) -> None:
    """H of the depth is (1000, 1) by mean and log-scale. One view adds (1000, 0), the other (0, 10).

    H of the colours is 100 everywhere. Ratios of single parameters would be 1 and 10, so the order would be reversed.
    """

    def view(mean: float, log_scale: float, logit: float) -> ViewInformation:
        numbers, none = np.zeros((1, 26), np.float32), np.zeros((1, 1))
        numbers[0, DIAGONAL[0]], numbers[0, DIAGONAL[3]], numbers[0, 21] = mean, log_scale, logit
        return ViewInformation(none, none, none, none, np.arange(1), numbers)

    color, depth, adding = view(0, 0, 100), view(1000, 1, 0), [view(1000, 0, 0), view(0, 10, 0)]
    known = {information._Trained: color, information._TrainedOfDepth: depth}
    memory = {kind: SimpleNamespace(of=lambda mapper, at=at: at.numbers[:, :24]) for kind, at in known.items()}
    two_walls.mapper = SimpleNamespace(memory=memory)
    monkeypatch.setattr(features, "COLOR_WEIGHT", weight)
    monkeypatch.setattr(features, "informed_views", lambda context: iter([color, color]))
    monkeypatch.setattr(features, "depth_informed_views", lambda context: iter(adding))
    found = features.next_best_sense(two_walls.context(*looks[:2]))
    assert 1.01 * found == pytest.approx(expected, abs=5e-4)  # lambda is 0.01 of the only Gaussian


def test_the_depth_is_known_whatever_the_colours(two_walls, looks, monkeypatch) -> None:
    monkeypatch.setattr(features, "COLOR_WEIGHT", 0.0)

    def of_depth() -> np.ndarray:
        return evaluate_features(("next_best_sense",), two_walls.context(*looks))[:, 0]

    before = of_depth()
    two_walls.mapper.map.parameters[11:] *= 0.1  # pale; H of the colours falls to a hundredth
    assert of_depth() == pytest.approx(before, rel=1e-4) and before[1] > 0.0


def test_with_coverage_the_unseen_north_is_first(two_walls, looks) -> None:
    (with_coverage,) = evaluate_features(("next_best_sense_cov",), two_walls.context(*looks)).T
    assert with_coverage.argmax() == 2
