"""Define GS-Planner: score unobserved volume and badly rendered surface, with a view library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, without_revisits
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import SPLATAM
from activestructure_gym.policies.scored import first_best

# The paper has no values for these constants. Gains are shares of the frustum's volume, plus the weighted loss.
QUALITY_WEIGHT = 0.1  # weight of the mean loss (metres); the share of unobserved volume has weight 1
MIN_GAIN = 0.02  # g_lb: views with a lower gain are dropped
STORED_GAIN = 0.05  # g_thres: views with a higher gain that are not chosen are stored in the library
MIN_OVERLAP = 0.5  # epsilon: views with at least this `overlap` count as the same view in the library
OVERLAP_M = 2.0  # metres; views at this distance have no overlap
OVERLAP_RAD = np.pi / 2.0  # radians; views with this angle between them have no overlap (width of the image)

VIEWPOINTS = 4  # number of places that are considered; 10 as in the paper would cover a whole room at this spacing
SPACING_M = 1.5  # metres between viewpoints (HGS-Planner's spacing), so that they are not all at the agent


def overlap(
    first: np.ndarray,  # [n, 6] position and view direction
    second: np.ndarray,  # [m, 6]
) -> np.ndarray:  # [n, m] in 0..1
    """Return the overlap of each pair of views: (1 - distance / 2 m) (1 - angle / 90 degrees), or 0 beyond either."""
    apart = np.linalg.norm(first[:, None, :3] - second[None, :, :3], axis=2)
    angle = np.arccos(np.clip(first[:, 3:] @ second[:, 3:].T, -1.0, 1.0))
    return np.maximum(1.0 - apart / OVERLAP_M, 0.0) * np.maximum(1.0 - angle / OVERLAP_RAD, 0.0)


def best_per_viewpoint(
    positions: np.ndarray,  # [n, 3] metres
    lengths: np.ndarray,  # [n] path length in metres
    gain: np.ndarray,  # [n]
) -> np.ndarray:  # [v] rows, nearest viewpoint first, at most VIEWPOINTS
    """Return the view with the largest gain around each of the four nearest places, which are at least 1.5 m apart.

    The original tests all directions at each viewpoint of its tree. The candidate table has few directions for each
    position, so the views around a place are used instead.
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
    """Choose argmax G = G_completeness + w G_quality among near views, then from a library ([gs_planner]).

    The two gains are the columns of the feature `gs_planner`. With the native travel term, the best view of each of the
    four nearest places is considered; the places replace one growth of the original's tree. The view with the largest G
    is chosen, and others with G above 0.05 are stored in a view library. If no G is at least 0.02, the best view of the
    library is chosen. If no candidate overlaps with one by half, the best of all views is chosen. The original ends the
    episode when the library is empty.
    Revisits are not candidates. Source: [gs_planner], by its text.
    """

    criterion = "unobserved volume behind transmittance, badly rendered surface"
    travel_term = "nearest places first, library of the rest"
    source = "by the text of Jin et al., GS-Planner, IROS 2024"
    required_features = ("gs_planner",)
    native_settings = replace(SPLATAM, changes={"sensor.max_range": 3.0, "volume.max_range": 3.0}, budget="")

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin an episode with an empty view library."""
        super().reset(seed)
        self._library = np.zeros((0, 6))  # position in metres and view direction of each view

    def act(self, observation: Observation) -> int:
        """Return the view with the largest G at a near place, or one from the view library."""
        volume, loss = self.candidates(observation).feature("gs_planner").astype(np.float64).T
        gain = volume + QUALITY_WEIGHT * loss
        observation = without_revisits(self.only_views(observation))
        if self.travel == "shared":
            choice, source = best_valid(self.scores(gain, observation), observation), "all"
        else:
            choice, source = self._local_or_library(gain, observation)
        self._trace = {"volume": float(volume[choice]), "loss": float(loss[choice]), "from": source}
        self._trace["library"] = len(self._library)
        return choice

    def _local_or_library(self, gain: np.ndarray, observation: Observation) -> tuple[int, str]:
        """Return the chosen row, and the name of the set that it was chosen from: "near", "library" or "all"."""
        candidates = self.candidates(observation)
        valid, lengths = np.flatnonzero(candidates.valid), candidates.path_length.astype(np.float64)
        views = np.hstack([candidates.xyz, candidates.view_direction]).astype(np.float64)
        rows = valid[best_per_viewpoint(views[valid, :3], lengths[valid], gain[valid])]
        rows = rows[gain[rows] >= MIN_GAIN]
        if len(rows):
            choice = first_best(rows, gain)
            self._forget(views[[choice]])
            self._store(views[rows[(gain[rows] > STORED_GAIN) & (rows != choice)]])
            return choice, "near"
        found = self._offered(views[valid], gain[valid])
        if len(found):
            choice = first_best(valid[found], gain)
            self._forget(views[[choice]])
            return choice, "library"
        return best_valid(gain, observation), "all"

    def _store(self, views: np.ndarray) -> None:  # [n, 6]
        """Add the views to the library, except views that overlap with one already in it by at least `MIN_OVERLAP`."""
        for view in views:
            if not len(self._library) or overlap(view[None], self._library).max() < MIN_OVERLAP:
                self._library = np.vstack([self._library, view])

    def _forget(self, chosen: np.ndarray) -> None:  # [1, 6]
        """Remove the views from the library that overlap with the ``chosen`` one by at least `MIN_OVERLAP`."""
        self._library = self._library[overlap(self._library, chosen).max(axis=1, initial=0.0) < MIN_OVERLAP]

    def _offered(self, views: np.ndarray, gain: np.ndarray) -> np.ndarray:  # [n, 6], [n] -> [f] rows
        """Return the rows of ``views`` that overlap most with each view of the library, without too small overlaps.

        Views whose gain has fallen below MIN_GAIN are removed from the library. Views without an overlapping candidate
        stay in it.
        """
        if not len(self._library) or not len(views):
            return np.zeros(0, dtype=np.int64)
        common = overlap(self._library, views)
        row = common.argmax(axis=1)
        offered = common.max(axis=1) >= MIN_OVERLAP
        useful = gain[row] >= MIN_GAIN
        self._library = self._library[~offered | useful]
        return row[offered & useful]
