import numpy as np

from activestructure_gym.evaluation.statistics import paired_difference


def test_pairs_share_scene_and_seed_and_the_rest_is_not_counted():
    ours = {("a", 0): 5.0, ("a", 1): 7.0, ("b", 0): 1.0, ("c", 0): 100.0}
    theirs = {("a", 0): 4.0, ("a", 1): 7.0, ("b", 0): 3.0, ("b", 1): 50.0}
    found = paired_difference(ours, theirs)
    # Scene a: +1 and 0; scene b: -2. Mean over the scenes of the means: (0.5 - 2) / 2.
    assert found.difference.value == -0.75
    assert (found.higher, found.equal, found.lower, found.pairs) == (1, 1, 1, 3)
    assert not found.difference.has_interval  # scene b has one pair


def test_pairing_sees_what_the_scenes_spread_hides():
    rng = np.random.default_rng(0)
    base = {(scene, seed): rng.normal(50.0, 20.0) for scene in "ab" for seed in range(5)}
    better = {cell: value + rng.normal(1.0, 0.1) for cell, value in base.items()}
    assert paired_difference(better, base).difference.excludes(0.0)
    assert paired_difference(base, base).difference.excludes(0.0) is False


def test_the_other_way_round_is_the_negative():
    rng = np.random.default_rng(1)
    ours = {("a", seed): rng.normal() for seed in range(6)}
    theirs = {("a", seed): rng.normal() for seed in range(6)}
    there, back = paired_difference(ours, theirs).difference, paired_difference(theirs, ours).difference
    np.testing.assert_allclose([there.value, there.low, there.high], [-back.value, -back.high, -back.low])


def test_nothing_in_common():
    assert paired_difference({("a", 0): 1.0}, {("a", 1): 1.0}) is None
