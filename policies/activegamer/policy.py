"""Define ActiveGAMER: cover uncovered pixels in two stages, then revisit the keyframes with the lowest PSNR."""

from __future__ import annotations

from collections import Counter

import numpy as np

from activestructure_gym.policies.base import POLICIES, Observation, best_valid, patience, travel_discount
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.greedy import Planner, Travel
from activestructure_gym.policies.native_settings import NativeSettings

STAGES = ("coarse", "fine", "post-refinement")
COARSE_STEP = 1.0  # metres between the positions of the coarse lattice
COARSE_DIRECTIONS = 5  # number of view directions of the coarse lattice, on the Fibonacci sphere
POOL_SHARE = 0.005  # share of the pixels: a view with fewer uncovered pixels leaves the pool of its stage permanently
GOOD_PSNR = 34.0  # dB; post-refinement ends when 90 % of the keyframes exceed it

# Candidate sources in the native setup, one per stage ([activegamer, code]); heights are above the floor.
ROWS = (512, 1024)  # largest number of views that a lattice offers; of more it offers a random draw
SOURCES = (
    f"lattice?spacing_m=1&directions=5&heights_m=1.75&from_floor=true&from_occupied_m=0.3&rows={ROWS[0]}",
    f"lattice?spacing_m=0.5&directions=15&heights_m=1,2.5&from_floor=true&from_occupied_m=0.3&rows={ROWS[1]}",
    "stay",
)
END = "finish"  # source of the row that ends the episode, offered with the last stage

# Limits that the original does not have: a view is not chosen again and again, and a stage without progress ends, as at
# an open window.
MAX_VISITS = 2  # maximum number of choices of one view in one stage
STAGNATION = 30  # a stage ends if no view of the pool has lost POOL_SHARE of its pixels in so many decisions


def travel_factor(distance: np.ndarray) -> np.ndarray:  # [n] metres -> [n] in [0, 1]
    """Return the travel factor 1 - softmax(d) of views at the distances d in metres.

    It is small only for a view that is much farther away than all others.
    """
    weight = np.exp(distance - distance.max(initial=0.0))  # the original adds 1e-6 to d, which cancels
    return 1.0 - weight / max(float(weight.sum()), 1e-12)


def coarse_views(
    offset: np.ndarray,  # [n, 3] metres from the start
    direction: np.ndarray,  # [n, 3] unit
) -> tuple[np.ndarray, np.ndarray]:  # [n, 3] int (ix, iy, direction), [n] metres plus radians
    """Return the nearest view of the coarse lattice for each of n views, and the distance to it.

    The lattice has its origin at the start, one height, a step of 1 m, and five Fibonacci directions. The distance is
    the sum of metres between the positions and radians between the view directions.
    """
    index = np.arange(COARSE_DIRECTIONS)
    z = 1.0 - (2.0 * index + 1.0) / COARSE_DIRECTIONS
    azimuth = 2.0 * np.pi * index / (0.5 * (1.0 + np.sqrt(5.0)))
    lattice = np.stack([np.sqrt(1.0 - z**2) * np.cos(azimuth), np.sqrt(1.0 - z**2) * np.sin(azimuth), z], axis=1)
    cosine = direction @ lattice.T
    cell = np.floor(offset[:, :2] / COARSE_STEP + 0.5 + 1e-3).astype(np.int64)
    away = np.linalg.norm(offset - np.pad(cell * COARSE_STEP, ((0, 0), (0, 1))), axis=1)
    angle = np.arccos(np.clip(cosine.max(axis=1, initial=-1.0), -1.0, 1.0))
    return np.column_stack([cell, cosine.argmax(axis=1)]), away + angle


@POLICIES.register("activegamer")
class ActiveGAMER(Planner):
    """Choose argmax (1 - e^{d_c} / sum_j e^{d_j}) IG_c / sum_j IG_j over the pool of the stage ([activegamer]).

    IG_c is the share of uncovered pixels of candidate c (feature `uncovered`), and d_c the distance from the agent in
    metres. Views with IG_c below 0.005 leave the pool after the choice. A stage ends when its pool is empty. In the
    native setup, the pools are the lattices themselves, post-refinement optimises the map without motion, and the
    episode ends when 90 % of the keyframes exceed 34 dB. Source: [activegamer, code].
    """

    criterion = "uncovered pixels in a coarse and a fine stage, then the worst keyframes"
    travel_term = "1 - softmax(metres)"
    source = "Chen et al., ActiveGAMER, CVPR 2025"
    required_features = ("uncovered",)
    native_settings = NativeSettings(
        mapper="splatam",
        iterations=15,
        stages=((SOURCES[0],), (SOURCES[1],), (SOURCES[2], END)),
        candidates=1027,
        # A place must once have been free 0.3 m from surface, the original's value for Matterport3D's houses; for
        # Replica's rooms it has 0.5 m. Surface and unknown space may be nearer, so the agent itself needs 0.1 m only.
        clearance_m=0.1,
        # The camera looks along the motion on paths of more than 36 points, 0.1 m apart.
        changes={"motion.min_clearance": 0.1, "motion.look_ahead_above": 3.6},
        budget="2000 frames of 1200 x 680 (Replica), 15 iterations; 5000 (MP3D)",
    )

    def __init__(self, travel: Travel = "native") -> None:
        super().__init__(travel)
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Begin with the coarse stage."""
        super().reset(seed)
        self._start = np.zeros(0)  # [3] metres, set by the first decision
        self._stage = 0
        self._active = 0  # stage whose sources the env offers
        self._begin_stage()

    def _begin_stage(self) -> None:
        """Reset the record of the previous stage: views removed from the pool, visits and progress."""
        self._pruned: set[tuple[int, ...]] = set()
        self._visits: Counter[tuple[int, ...]] = Counter()
        self._poor = 0  # successive decisions without a view above POOL_SHARE
        self._known: dict[tuple[int, ...], float] = {}  # uncovered share of each view when it was last offered
        self._stagnant = 0  # successive decisions without progress

    def act(self, observation: Observation) -> int:
        """Return the best view of the stage's pool; in post-refinement the keyframe with the lowest PSNR."""
        candidates = self.candidates(observation)
        if candidates.offers(SOURCES[0]):
            return self._act_on_lattices(observation, candidates)
        observation = self.only_views(observation)
        candidates = self.candidates(observation)
        valid = candidates.valid
        if not len(self._start):
            self._start = observation["pose"][:3].astype(np.float64)
        gain = candidates["uncovered"].astype(np.float64)
        keys, pool = self._pool(candidates)
        ended = self._ended(keys, gain, pool, patience(len(valid))) if STAGES[self._stage] != STAGES[-1] else None
        if ended:
            self._stage += 1
            self._begin_stage()
            keys, pool = self._pool(candidates)
        self._trace = {"stage": STAGES[self._stage], "pool": int(pool.sum()), "changed": ended}
        revisits = valid & candidates.revisit
        if STAGES[self._stage] == STAGES[-1] and revisits.any() and float(observation["fidelity"][0]) < GOOD_PSNR:
            # The table lists the keyframe with the lowest PSNR first. The original uses no distance factor here.
            nearness = travel_discount(observation) if self.travel == "shared" else np.ones(len(valid))
            return best_valid(revisits * nearness, observation)
        # The original ends a stage as soon as its pool is empty. This pool is a random part of a larger one, so the
        # stage goes on for several decisions (`patience`).
        scored = pool if pool.any() else valid & ~revisits if (valid & ~revisits).any() else valid
        scores = np.where(scored, self._scores(observation, gain, scored), -np.inf)
        choice = best_valid(scores, observation)
        self._trace |= {"uncovered": float(gain[choice]), "score": float(scores[choice])}
        self._visits[keys[choice]] += 1
        self._pruned |= {keys[row] for row in np.flatnonzero(pool & (gain < POOL_SHARE))}
        return choice

    def _act_on_lattices(self, observation: Observation, candidates: Candidates) -> int:
        """Return the choice in the native setup, where each stage has its own lattice as the pool.

        The choice is among all views that no earlier decision removed. Then views with less than POOL_SHARE uncovered
        pixels are removed. A full table is a random draw, so the stage goes on for several decisions (`patience`). If
        the table is not full, an empty pool ends the stage immediately.
        """
        gain, valid = candidates["uncovered"].astype(np.float64), candidates.valid
        if self._stage < 2 and self._active == self._stage:
            offered = valid & candidates.source(SOURCES[self._stage])
            names = np.round(100.0 * np.hstack([candidates.xyz, candidates.view_direction])).astype(np.int64)
            keys = [tuple(name) for name in names.tolist()]
            pool = offered & np.array([key not in self._pruned for key in keys], dtype=bool)
            drawn = int(offered.sum()) >= ROWS[self._stage]
            late = self._ended(keys, gain, pool, patience(ROWS[self._stage]) if drawn else STAGNATION)
            if (pool.any() or drawn) and not late:
                scored = pool if pool.any() else offered
                scores = np.where(scored, self._scores(observation, gain, scored), -np.inf)
                choice = best_valid(scores, observation)
                self._pruned |= {keys[row] for row in np.flatnonzero(pool & (gain < POOL_SHARE))}
                self._trace = {"stage": STAGES[self._stage], "pool": int(pool.sum()), "uncovered": float(gain[choice])}
                return choice
            self._stage += 1
            self._begin_stage()
        if candidates.offers(END) and float(observation["fidelity"][0]) >= GOOD_PSNR:
            ending = np.flatnonzero(candidates.source(END) & valid)
            if len(ending):
                self._trace = {"stage": "end", "pool": 0}
                return int(ending[0])
        self._trace = {"stage": STAGES[self._stage], "pool": 0}
        offered = valid & candidates.source(SOURCES[self._active])
        stages = [self._stage] if offered.any() else [self._stage, 0, 1, 2]  # without candidates, switch to any stage
        for stage in stages if self._active != self._stage or not offered.any() else []:
            row = candidates.stage_switch(stage)
            if row is not None and valid[row]:
                self._active = stage
                return row
        return best_valid(np.where(offered, gain + candidates.stay, -np.inf), observation)

    def _scores(self, observation: Observation, gain: np.ndarray, among: np.ndarray) -> np.ndarray:  # [K]
        """Return gain / sum of gains x travel factor of every candidate; sums are over the rows ``among`` [K] bool."""
        total = float(gain[among].sum())
        share = gain / total if total > 0 else np.ones(len(gain))  # without a gain the original computes 0 / 0
        if self.travel == "shared":
            return share * travel_discount(observation)
        factor = np.zeros(len(gain))
        moved = self.candidates(observation).xyz[among].astype(np.float64) - observation["pose"][:3]
        factor[among] = travel_factor(np.linalg.norm(moved, axis=1))
        return share * factor

    def _pool(self, candidates: Candidates) -> tuple[list[tuple[int, ...]], np.ndarray]:
        """Return a key of each row's view, and which rows [K] bool are in the pool of the current stage.

        A view has the same key in all decisions of a stage. In the coarse stage, the pool contains the candidate
        nearest to each view of the coarse lattice.
        """
        xyz, direction = candidates.xyz.astype(np.float64), candidates.view_direction.astype(np.float64)
        pool = candidates.valid & ~candidates.revisit
        names = np.round(100.0 * np.hstack([xyz, direction])).astype(np.int64)
        if STAGES[self._stage] == STAGES[0]:
            names, away = coarse_views(xyz - self._start, direction)
            nearest = np.full(len(pool), False)
            order = np.lexsort((away, ~pool))  # candidates of the pool first, by distance
            nearest[order[np.unique(names[order], axis=0, return_index=True)[1]]] = True
            pool &= nearest
        keys = [tuple(int(n) for n in name) for name in names]
        kept = [key not in self._pruned and self._visits[key] < MAX_VISITS for key in keys]
        return keys, pool & np.array(kept, dtype=bool)

    def _ended(self, keys: list[tuple[int, ...]], gain: np.ndarray, pool: np.ndarray, needed: int) -> str | None:
        """Return the reason for ending the stage, or None.

        ``keys`` names the view of each row, ``gain`` [K] is its share of uncovered pixels, and ``pool`` [K] the rows
        that count. ``needed`` successive decisions without a view above POOL_SHARE end the stage. A decision makes
        progress if a view has lost POOL_SHARE of its pixels since it was first offered, or since its last such loss.
        """
        shares = {keys[row]: float(gain[row]) for row in np.flatnonzero(pool)}
        self._poor = 0 if max(shares.values(), default=0.0) >= POOL_SHARE else self._poor + 1
        fell = {key: s for key, s in shares.items() if key in self._known and s <= self._known[key] - POOL_SHARE}
        self._stagnant = 0 if fell else self._stagnant + 1
        self._known = shares | self._known | fell
        if self._poor >= needed:
            return f"the pool was empty for {needed} decisions"
        return f"no progress in {STAGNATION} decisions" if self._stagnant > STAGNATION else None
