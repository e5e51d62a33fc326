"""Define HGS-Planner ([hgs_planner], by its text): follow a tour of good local views, then a tour of other regions."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.base import POLICIES, Observation, best_valid, without_revisits
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Greedy, Travel
from activestructure_gym.policies.native_settings import SPLATAM

LOCAL_M = 3.0  # metres from the agent along x and y: half the local window of 6 x 6 m
CUBOID_M = 6.0  # metres, horizontal side of the regions of the tour
APART_M = 1.5  # metres, minimum distance between the views of a local tour
MIN_COVERAGE = 0.05  # minimum G_cov of a useful view; 1 is a view of only unseen space
_MAX_STOPS = 6  # maximum number of stops of a tour; all their orders are tested
Sum = Literal["ranked", "raw"]


@POLICIES.register("hgs_planner")
class HGSPlanner(Greedy):
    """Choose the first view of a tour of the views with high G = G_cov + lambda_o G_Q, local ones before other regions.

    G_cov is the unseen space that a view would show, and G_Q its Fisher information (feature `hgs_planner`). A view is
    useful if its G_cov is above 0.05. The tour is the shortest one through the useful views of the local window that
    are the best within 1.5 m. Without any, the regions that contain useful views are visited in the order of the
    shortest tour, each at its best view. Without any useful view, all views are scored by G. Revisits are not
    candidates. With ``travel=shared`` there are no stages: all views are scored by G times the shared factor.

    Parameters
    ----------
    sum
        ``"ranked"`` makes the two terms comparable: G_cov as a share of the best, G_Q by its rank. ``"raw"`` adds them
        without a common unit, as the paper's text does.
    """

    criterion = "unseen space through transmittance, Fisher information"
    travel_term = "local window, then a tour"
    source = "by the text of Xu et al., HGS-Planner, ICRA 2025"
    required_features = ("hgs_planner", "hgs_coverage")
    native_settings = replace(SPLATAM, changes={"sensor.max_range": 5.0}, budget="")

    def __init__(self, travel: Travel = "native", sum: Sum = "ranked") -> None:
        """Store the travel term and the form of the sum; raise `InputError` for an unknown form."""
        super().__init__(travel)
        if sum not in get_args(Sum):
            raise InputError(f"option sum must be {' or '.join(get_args(Sum))}, got '{sum}'")
        self.required_features = ("hgs_planner" if sum == "ranked" else "hgs_planner_raw", "hgs_coverage")

    def act(self, observation: Observation) -> int:
        """Return the valid row of the current stage with the highest G."""
        observation = without_revisits(self.only_views(observation))
        if self.travel == "shared":
            return super().act(observation)
        candidates = self.candidates(observation)
        name = self.required_features[0]
        gain, coverage, valid = candidates[name], candidates["hgs_coverage"], candidates.valid
        useful = valid & (coverage > MIN_COVERAGE)
        near = useful & (np.abs(candidates.xyz[:, :2] - observation["pose"][:2]) <= LOCAL_M).all(axis=1)
        if near.any():
            stage, choice = "local", next_view(candidates, near, gain)
        else:
            stage, pool = ("global", next_region(candidates, useful)) if useful.any() else ("refine", valid)
            choice = best_valid(np.where(pool, gain, -np.inf), observation)
        self._trace = {"stage": stage, name: float(gain[choice]), "hgs_coverage": float(coverage[choice])}
        return choice


def next_view(candidates: Candidates, among: np.ndarray, gain: np.ndarray) -> int:
    """Return the first row of the shortest tour through the rows ``among`` [K] that are the best within `APART_M`.

    Rows are taken in the order of ``gain`` [K], highest first, unless one that is taken is nearer than `APART_M`.
    """
    rows = np.flatnonzero(among)
    places = candidates.xyz.astype(np.float64)
    stops = list[int]()
    for row in rows[np.argsort(-gain[rows], kind="stable")].tolist():
        if not stops or np.linalg.norm(places[stops] - places[row], axis=1).min() >= APART_M:
            stops.append(row)
    return stops[shortest_tour(candidates.path_length[stops], places[stops])[0]]


def next_region(candidates: Candidates, useful: np.ndarray) -> np.ndarray:  # [K] bool, some True -> [K] bool
    """Return which useful candidates are in the first region of the shortest tour through the regions with such views.

    Regions are squares of 6 m in the floor plane. ``useful`` are the useful candidates.
    """
    places = candidates.xyz[:, :2]
    cuboids = np.floor(places / CUBOID_M).astype(np.int64)
    regions, of_region = np.unique(cuboids[useful], axis=0, return_inverse=True)
    of_region = of_region.reshape(-1)
    centres = np.array([[axis[useful][of_region == r].mean() for axis in places.T] for r in range(len(regions))])
    lengths = np.array([candidates.path_length[useful][of_region == r].min() for r in range(len(regions))])
    return useful & (cuboids == regions[shortest_tour(lengths, centres)[0]]).all(axis=1)


def shortest_tour(
    lengths: np.ndarray,  # [P] path length in metres from the agent to each place
    centres: np.ndarray,  # [P, 2 or 3] metres
) -> tuple[int, ...]:
    """Return the indices of the six nearest places (or fewer) in the order of the shortest open tour from the agent."""
    nearest = np.argsort(lengths, kind="stable")[:_MAX_STOPS]
    between = np.linalg.norm(centres[:, None] - centres[None], axis=2)

    def length(tour: tuple[int, ...]) -> float:
        return float(lengths[tour[0]] + sum(between[a, b] for a, b in zip(tour, tour[1:])))

    return min(permutations(nearest.tolist()), key=length)
