"""GS-Planner: unobserved volume that light would reach, badly rendered surface, and a library of views left behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, without_revisits
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import SPLATAM

# The paper prints no values for these; ours are shares of what a view could gain at most.
QUALITY_WEIGHT = 0.1  # of the mean loss in metres against the share of unobserved volume
MIN_GAIN = 0.02  # g_lb: a view below is dropped
STORED_GAIN = 0.05  # g_thres: a view above that is not chosen goes into the library
MIN_OVERLAP = 0.5  # epsilon: from this overlap on two views are one to the library
OVERLAP_M = 2.0  # metres apart at which two views have nothing in common
OVERLAP_RAD = np.pi / 2.0  # angle between them at which they have nothing in common: the width of the image

VIEWPOINTS = 4  # that an iteration of the tree adds: more of them are all there is in a room, and nothing is far
SPACING_M = 1.5  # metres between them: of HGS-Planner's samples, so that they do not crowd around the agent


def overlap(first: np.ndarray, second: np.ndarray) -> np.ndarray:  # [n, 6], [m, 6] position and look -> [n, m] in 0..1
    """Overlap of two views, from the distance and the angle between them alone."""
    apart = np.linalg.norm(first[:, None, :3] - second[None, :, :3], axis=2)
    angle = np.arccos(np.clip(first[:, 3:] @ second[:, 3:].T, -1.0, 1.0))
    return np.maximum(1.0 - apart / OVERLAP_M, 0.0) * np.maximum(1.0 - angle / OVERLAP_RAD, 0.0)


def best_per_viewpoint(
    positions: np.ndarray,  # [n, 3] metres
    lengths: np.ndarray,  # [n] metres of way
    gain: np.ndarray,  # [n]
) -> np.ndarray:  # [v] rows, nearest viewpoint first, at most VIEWPOINTS
    """The best view around each of the nearest places that keep SPACING_M from each other.

    The original turns a window over 360 degrees at each viewpoint of its tree. A table of all positions holds few
    directions of any one, so the views around a place stand for those at it.
    """
    left = np.argsort(lengths, kind="stable")
    best: list[int] = []
    while len(left) and len(best) < VIEWPOINTS:
        around = np.linalg.norm(positions[left] - positions[left[0]], axis=1) < SPACING_M
        best.append(int(left[around][np.argmax(gain[left[around]])]))
        left = left[~around]
    return np.array(best, dtype=np.int64)


@POLICIES.register("gs_planner")
class GSPlanner(Planner):
    """G = G_completeness + w G_quality, the columns of the feature `gs_planner` ([gs_planner]).

    Native: the best of the VIEWPOINTS nearest places, each with its best view, as one growth of the original's tree
    from the agent offers them; others worth a visit go into a view library. Where none of the near ones is worth
    MIN_GAIN, the best of the library; where that is empty the original ends, and here the best view of all is taken.
    Revisits are no candidates of it.
    Source: [gs_planner], by its text.
    """

    criterion = "unobserved volume behind transmittance, badly rendered surface"
    travel_term = "nearest places first, library of the rest"
    source = "by the text of Jin et al., GS-Planner, IROS 2024"
    required_features = ("gs_planner",)
    native_settings = replace(SPLATAM, budget="")

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin with an empty library."""
        super().reset(seed)
        self._library = np.zeros((0, 6))  # position [m] and look of each view

    def act(self, observation: Observation) -> int:
        """The best near view, or one from the library."""
        volume, loss = self.candidates(observation).feature("gs_planner").astype(np.float64).T
        gain = volume + QUALITY_WEIGHT * loss
        observation = without_revisits(observation)
        if self.travel == "shared":
            choice, source = best_valid(self.scores(gain, observation), observation), "all"
        else:
            choice, source = self._local_or_library(gain, observation)
        self._trace = {"volume": float(volume[choice]), "loss": float(loss[choice]), "from": source}
        self._trace["library"] = len(self._library)
        return choice

    def _local_or_library(self, gain: np.ndarray, observation: Observation) -> tuple[int, str]:
        candidates = self.candidates(observation)
        valid, lengths = np.flatnonzero(candidates.valid), candidates.path_length.astype(np.float64)
        views = np.hstack([candidates.xyz, candidates.view_direction]).astype(np.float64)
        rows = valid[best_per_viewpoint(views[valid, :3], lengths[valid], gain[valid])]
        rows = rows[gain[rows] >= MIN_GAIN]
        if len(rows):
            choice = int(rows[np.argmax(gain[rows])])
            self._forget(views[[choice]])
            self._store(views[rows[(gain[rows] > STORED_GAIN) & (rows != choice)]])
            return choice, "near"
        found = self._offered(views[valid], gain[valid])
        if len(found):
            choice = int(valid[found[np.argmax(gain[valid[found]])]])
            self._forget(views[[choice]])
            return choice, "library"
        return best_valid(gain, observation), "all"

    def _store(self, views: np.ndarray) -> None:  # [n, 6]
        for view in views:
            if not len(self._library) or overlap(view[None], self._library).max() < MIN_OVERLAP:
                self._library = np.vstack([self._library, view])

    def _forget(self, chosen: np.ndarray) -> None:  # [1, 6]
        self._library = self._library[overlap(self._library, chosen).max(axis=1, initial=0.0) < MIN_OVERLAP]

    def _offered(self, views: np.ndarray, gain: np.ndarray) -> np.ndarray:  # [n, 6], [n] -> [f] rows
        """Where the library's views, or what has most in common with them, stand in the table.

        Those that lost their gain since leave the library; those that are not on offer this time stay.
        """
        if not len(self._library) or not len(views):
            return np.zeros(0, dtype=np.int64)
        common = overlap(self._library, views)
        row = common.argmax(axis=1)
        offered = common.max(axis=1) >= MIN_OVERLAP
        worth = gain[row] >= MIN_GAIN
        self._library = self._library[~offered | worth]
        return row[offered & worth]
