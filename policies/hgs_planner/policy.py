"""HGS-Planner ([hgs_planner], by its text): local views by gain, then a tour through the parts that are not done."""

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

LOCAL_M = 3.0  # metres from the agent along x and along y: half the local window of 6 x 6 m
CUBOID_M = 6.0  # metres, horizontal side of the global parts
WORTH = 0.05  # of a view into nothing but unknown space; a part with a better view than that is not done
_MAX_PARTS = 6  # parts of a tour that is searched through in full
Sum = Literal["ranked", "raw"]


@POLICIES.register("hgs_planner")
class HGSPlanner(Greedy):
    """argmax G = G_cov + lambda_o G_Q in the local window; if nothing there is worth it, on to the next part.

    A view is worth going to while its G_cov is above `WORTH`. Parts that hold such views are visited in the order of
    the shortest tour, as long as there are any; at last the whole pool is scored by G. Revisits are not in the pool.
    With ``travel=shared`` there are no stages: G times the shared factor over the whole pool.

    Parameters
    ----------
    sum
        ``"ranked"`` makes the two terms comparable, G_cov as a share of the best and G_Q by its rank; ``"raw"`` adds
        them as the text does, which names no unit.
    """

    criterion = "unseen space through transmittance, Fisher information"
    travel_term = "local window, then a tour"
    source = "by the text of Xu et al., HGS-Planner, ICRA 2025"
    required_features = ("hgs_planner", "hgs_coverage")
    native_settings = replace(SPLATAM, budget="")

    def __init__(self, travel: Travel = "native", sum: Sum = "ranked") -> None:
        super().__init__(travel)
        if sum not in get_args(Sum):
            raise InputError(f"option sum must be {' or '.join(get_args(Sum))}, got '{sum}'")
        self.required_features = ("hgs_planner" if sum == "ranked" else "hgs_planner_raw", "hgs_coverage")

    def act(self, observation: Observation) -> int:
        """The valid row of the present stage with the highest G."""
        observation = without_revisits(observation)
        if self.travel == "shared":
            return super().act(observation)
        candidates = self.candidates(observation)
        name = self.required_features[0]
        gain, coverage, valid = candidates[name], candidates["hgs_coverage"], candidates.valid
        worth = valid & (coverage > WORTH)
        near = worth & (np.abs(candidates.xyz[:, :2] - observation["pose"][:2]) <= LOCAL_M).all(axis=1)
        if near.any():
            stage, pool = "local", near
        elif worth.any():
            stage, pool = "global", worth & next_part(candidates, worth)
        else:
            stage, pool = "refine", valid
        choice = best_valid(np.where(pool, gain, -np.inf), observation)
        self._trace = {"stage": stage, name: float(gain[choice]), "hgs_coverage": float(coverage[choice])}
        return choice


def next_part(candidates: Candidates, worth: np.ndarray) -> np.ndarray:  # [K] bool, some True -> [K] bool
    """The candidates in the first cuboid of the tour through those that hold a view worth going to."""
    places = candidates.xyz[:, :2]
    cuboids = np.floor(places / CUBOID_M).astype(np.int64)
    parts, of_part = np.unique(cuboids[worth], axis=0, return_inverse=True)
    of_part = of_part.reshape(-1)
    middles = np.array([[axis[worth][of_part == p].mean() for axis in places.T] for p in range(len(parts))])
    ways = np.array([candidates.path_length[worth][of_part == p].min() for p in range(len(parts))])
    return (cuboids == parts[first_of_tour(ways, middles)]).all(axis=1)


def first_of_tour(
    ways: np.ndarray,  # [P] metres from the agent to each part
    middles: np.ndarray,  # [P, 2] metres
) -> int:
    """Where the shortest open tour through the nearest `_MAX_PARTS` parts begins."""
    return shortest_tour(ways, middles)[0]


def shortest_tour(
    ways: np.ndarray,  # [P] metres from the agent to each part
    middles: np.ndarray,  # [P, 2] metres
) -> tuple[int, ...]:
    """The order of the nearest `_MAX_PARTS` parts on the shortest open tour through them."""
    nearest = np.argsort(ways, kind="stable")[:_MAX_PARTS]
    between = np.linalg.norm(middles[:, None] - middles[None], axis=2)

    def length(tour: tuple[int, ...]) -> float:
        return float(ways[tour[0]] + sum(between[a, b] for a, b in zip(tour, tour[1:])))

    return min(permutations(nearest.tolist()), key=length)
