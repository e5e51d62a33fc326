"""Compare two policies by paired runs: the same scene and seed, hence the same start, noise and candidates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from activestructure_gym.evaluation.statistics.aggregates import Statistic, mean
from activestructure_gym.evaluation.statistics.resampling import LEVEL, REPEATS, Estimate, estimate

Cell = tuple[str, int]  # scene and seed


@dataclass(frozen=True)
class PairedDifference:
    """Hold the aggregated difference of ours minus theirs, and the numbers of pairs by sign."""

    difference: Estimate
    higher: int  # number of pairs in which ours is larger
    equal: int
    lower: int

    @property
    def pairs(self) -> int:
        """Return the number of pairs: cells that both policies have."""
        return self.higher + self.equal + self.lower


def paired_difference(
    ours: Mapping[Cell, float],
    theirs: Mapping[Cell, float],
    statistic: Statistic = mean,
    *,
    tie: float = 0.0,
    level: float = LEVEL,
    repeats: int = REPEATS,
    seed: int = 0,
) -> PairedDifference | None:
    """Return the statistic of the differences over all common cells; pairs are resampled within each scene.

    Parameters
    ----------
    ours, theirs
        A number per (scene, seed).
    statistic
        Aggregate of the differences: `mean`, `median` or `interquartile_mean`.
    tie
        Pairs that differ by no more than this count as equal.
    level
        Share of the resampled statistics inside the interval.
    repeats
        Number of resamples.
    seed
        Seed of the resampling.

    Returns
    -------
    PairedDifference or None
        None if they have no cell in common. Cells that only one of them has are ignored.

    Examples
    --------
    >>> ours = {("room", 0): 3.0, ("room", 1): 4.0, ("room", 2): 9.0}
    >>> found = paired_difference(ours, {("room", 0): 1.0, ("room", 1): 4.0})
    >>> found.difference.value, found.higher, found.equal, found.lower
    (1.0, 1, 1, 0)
    """
    by_scene: dict[str, list[float]] = {}
    for scene, number in sorted(ours.keys() & theirs.keys()):
        by_scene.setdefault(scene, []).append(ours[scene, number] - theirs[scene, number])
    if not by_scene:
        return None
    strata = [np.array(values) for values in by_scene.values()]
    every = np.concatenate(strata)
    found = estimate(strata, statistic, level=level, repeats=repeats, seed=seed)
    higher, lower = int((every > tie).sum()), int((every < -tie).sum())
    return PairedDifference(found, higher, len(every) - higher - lower, lower)
