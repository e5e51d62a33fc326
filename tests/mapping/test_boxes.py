"""Boxes that are kept are those that would be measured anew."""

import copy

import numpy as np
import pytest

from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.boxes import BLOCK, block_boxes

CHUNK = 1024


def _gaussians(rng, count):
    block = rng.normal(size=(14, count)).astype(np.float32)
    block[:3] *= 5.0
    return block


def _same(gaussians):
    return gaussians.boxes().tobytes() == block_boxes(gaussians.parameters, gaussians.count).tobytes()


@pytest.mark.parametrize("seed", range(4))
def test_kept_boxes_follow_whatever_happens_to_the_map(seed):
    """Seeds, removals, steps in some chunks, growing arrays and copies, in any order and asked for now and then."""
    rng = np.random.default_rng(seed)
    gaussians = GaussianMap(64)
    compared = 0
    for _ in range(300):
        what = rng.integers(5)
        if what == 0:
            gaussians.append(_gaussians(rng, int(rng.integers(0, 900))))
        elif what == 1 and gaussians.count:
            kept = rng.random(gaussians.count) < rng.choice([0.5, 0.99, 1.0])
            kept[int(gaussians.count * rng.choice([0.3, 1.0])) :] = False
            gaussians.keep(kept)
        elif what == 2:
            gaussians.keep(np.arange(gaussians.count) < gaussians.count // BLOCK * BLOCK)  # ends with a full block
        elif what == 3:
            chunks = rng.random(-(-gaussians.count // CHUNK)) < 0.3
            moved = np.flatnonzero(chunks.repeat(CHUNK)[: gaussians.count])
            gaussians.parameters[:10, moved] += rng.normal(0, 0.1, (10, len(moved))).astype(np.float32)
            gaussians.touched(chunks)
        elif rng.random() < 0.1:
            gaussians = copy.deepcopy(gaussians)
        if rng.random() < 0.5:
            compared += gaussians.count > 0
            assert _same(gaussians)
    assert compared > 50


def test_what_is_not_said_is_not_seen():
    """Only the blocks that are said to have changed are read: else keeping boxes would save nothing."""
    gaussians = GaussianMap()
    gaussians.append(_gaussians(np.random.default_rng(0), 3000))
    assert _same(gaussians)
    gaussians.parameters[0, [10, 2999]] = 1e3
    assert not (gaussians.boxes()[:, 3] == 1e3).any()
    gaussians.touched(np.array([False, False, True]))
    assert (gaussians.boxes()[:, 3] == 1e3).tolist() == [False] * 11 + [True]
    gaussians.touched()
    assert _same(gaussians) and gaussians.boxes()[0, 3] == 1e3
