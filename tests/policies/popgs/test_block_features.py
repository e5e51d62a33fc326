"""The block forms against numpy, and against the diagonal forms where blocks are diagonal."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.features.information import LAMBDA, trained, units
from activestructure_gym.policies.popgs import block_features as popgs_block
from activestructure_gym.policies.popgs.block_features import block_numbers, popgs_cov_trace_block, popgs_logdet_block
from activestructure_gym.policies.popgs.features import popgs_cov_trace, popgs_logdet
from activestructure_gym.splatting.fisher import ViewInformation, full_blocks, view_information

ROW, COLUMN = np.triu_indices(6)


def psd(rng: np.random.Generator, count: int, rank: int, size: float) -> np.ndarray:  # [count, 21]
    factor = rng.normal(size=(count, rank, 6)) * np.sqrt(size)
    return np.ascontiguousarray(np.einsum("nri,nrj->nij", factor, factor)[:, ROW, COLUMN])


@pytest.mark.parametrize(("count", "rank", "size"), [(1, 6, 1.0), (64, 6, 1.0), (65, 2, 10.0), (200, 1, 1e-3)])
def test_determinants_and_traces_are_those_of_numpy(count, rank, size, rng) -> None:
    prior, blocks = psd(rng, 2 * count, 3, 1.0), psd(rng, count, rank, size).astype(np.float32)
    indices = rng.permutation(2 * count)[:count]
    inverse_units = rng.uniform(0.9, 1.1, 6)
    inverse_units = inverse_units[ROW] * inverse_units[COLUMN]
    found = block_numbers(prior, indices, blocks, inverse_units, LAMBDA)
    whole = full_blocks(prior[indices] + blocks * inverse_units) + LAMBDA * np.eye(6)
    assert found[:, 0] == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-6, abs=1e-6)
    assert found[:, 1] == pytest.approx(np.trace(np.linalg.inv(whole), axis1=1, axis2=2), rel=1e-5)


def test_rounding_of_large_blocks_without_rank_makes_no_view_harmful(two_walls, looks, monkeypatch, rng) -> None:
    prior, blocks = np.zeros((50, 21)), psd(rng, 50, 1, 1e6).astype(np.float32)
    found = block_numbers(prior, np.arange(50), blocks, np.ones(21), LAMBDA)
    before = block_numbers(prior, np.arange(50), blocks[:0], np.ones(21), LAMBDA)
    assert before[:, 0] == pytest.approx(6 * np.log(LAMBDA)) and before[:, 1] == pytest.approx(600.0)
    assert (found[:, 0] > before[:, 0]).all() and (found[:, 1] > before[:, 1]).any()
    huge = np.zeros((50, 26), np.float32)
    huge[:, :21], picture = blocks, np.zeros((1, 1))
    view = ViewInformation(picture, picture, picture, picture, np.arange(50), huge)
    monkeypatch.setattr(popgs_block, "informed_views", lambda context: iter([view]))
    two_walls.mapper.keyframe_information = lambda camera: np.zeros((50, 24))
    assert 0.0 <= popgs_cov_trace_block(two_walls.context(looks[0]))[0] <= 600.0


def test_of_diagonal_blocks_they_are_the_diagonal_forms(hand_made) -> None:
    assert popgs_logdet_block(hand_made) == pytest.approx(popgs_logdet(hand_made))
    assert popgs_cov_trace_block(hand_made) == pytest.approx(popgs_cov_trace(hand_made))


def test_of_a_map_they_are_the_sums_over_its_gaussians(two_walls, looks) -> None:
    context, gaussians = two_walls.context(*looks), two_walls.mapper.map
    root = np.sqrt(np.repeat(units(context)[:2], 3))
    prior = full_blocks(trained(context)[:, :21]) / root / root[:, None]
    prior += LAMBDA * np.eye(6)
    logdets, traces = [], []
    for pose in looks:
        (view,) = view_information(gaussians.parameters, gaussians.count, context.camera, pose)
        before, after = prior[view.indices], prior[view.indices] + full_blocks(view.blocks) / root / root[:, None]
        logdets.append((np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1]).sum() / gaussians.count)
        inverse = np.linalg.inv(before) - np.linalg.inv(after)
        traces.append(np.trace(inverse, axis1=1, axis2=2).sum() / gaussians.count)
    found = evaluate_features(("popgs_logdet_block", "popgs_cov_trace_block"), context).T
    assert found[0] == pytest.approx(logdets, rel=1e-4) and found[1] == pytest.approx(traces, rel=1e-3)
    assert found[0, 2] == 0.0 < found[0, 0] < found[0, 1]
    # Correlated parameters tell less than the same ones taken as independent.
    assert (found[0, :2] < popgs_logdet(context)[:2]).all()
