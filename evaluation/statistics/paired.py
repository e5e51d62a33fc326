"""Compare two policies by pairs of runs with the same scene and seed, hence the same start, noise and candidates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from activestructure_gym.evaluation.statistics.aggregates import Statistic, mean
from activestructure_gym.evaluation.statistics.intervals import LEVEL, Estimate, estimate

Cell = tuple[str, int]  # scene and seed


@dataclass(frozen=True)
class PairedDifference:
    """Hold the aggregate of the differences "ours minus theirs" of all pairs, and the number of pairs by sign."""

    difference: Estimate
    higher: int  # number of pairs in which ours is larger
    equal: int  # number of pairs that differ by at most the tie
    lower: int  # number of pairs in which ours is smaller

    @property
    def pairs(self) -> int:
        """Return the number of pairs."""
        return self.higher + self.equal + self.lower


def paired_difference(
    ours: Mapping[Cell, float],
    theirs: Mapping[Cell, float],
    statistic: Statistic = mean,
    *,
    tie: float = 0.0,
    level: float = LEVEL,
) -> PairedDifference | None:
    """Aggregate the differences "ours minus theirs" over all common cells; a cell is a scene and a seed.

    Parameters
    ----------
    ours, theirs
        The value of each run of a policy, by cell (scene, seed).
    statistic
        Aggregate of the differences: `mean`, `median` or `interquartile_mean`.
    tie
        Pairs that differ by no more than this count as equal.
    level
        Confidence level of the interval.

    Returns
    -------
    PairedDifference or None
        None if there is no common cell. Cells of only one policy are ignored.

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
    found = estimate(strata, statistic, level=level)
    higher, lower = int((every > tie).sum()), int((every < -tie).sum())
    return PairedDifference(found, higher, len(every) - higher - lower, lower)
