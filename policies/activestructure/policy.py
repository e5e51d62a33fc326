"""ActiveStructure as a policy: Eq. 15, the phases, and the rungs A to E of Table 3."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.policies.activestructure.information_gain import (
    GainTerms,
    PlaneView,
    Weights,
    information_gain,
    plane_view,
)
from activestructure_gym.policies.activestructure.phases import (
    GOOD_PSNR,
    LOT,
    MIN_RISE_DB,
    PHASES,
    Mending,
    PhaseMachine,
    SentTo,
    in_pool,
)
from activestructure_gym.policies.base import POLICIES, Observation, Policy, best_valid, travel_discount
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.native_settings import SPLATAM
from activestructure_gym.policies.pixel_only.policy import PixelOnly
from activestructure_gym.policies.unseen.policy import SIDE_DEPTH

Discovery = Literal["pixel", "hole_area", "unknown_volume", "unseen"]
_SIDES, _END = "unseen_sides", "finish"
_ON_BASE = replace(PHASES[0].weights, sides=1.0)
# The columns that stand for IG_px and what of each counts 1: a whole image, the largest hole area, and the volume (m^3)
# that a view into nothing but unknown space opens: its solid angle, 1.42 sr at 90 x 59 degrees, times the integral of
# r^2 exp(-r) from 0 to 6 m. On a grid, where rays leave voxels out, such a view has 2.2.
_DISCOVERY: dict[Discovery, dict[str, float]] = {
    "pixel": {"pixel": 1.0},
    "hole_area": {"hole_area": 1.0},
    "unknown_volume": {"unknown_volume_way": 2.7},
    "unseen": {"unknown_volume_way": 2.7, _SIDES: 2.7 / SIDE_DEPTH},
}


def discovering(gain: np.ndarray, observation: Observation) -> np.ndarray:  # [K]
    """The gain without the revisits: a keyframe always sees the planes it founded. They belong to phase III."""
    return np.where(Candidates(observation).revisit, 0.0, gain)


class StructurePolicy(Policy):
    """T* = argmax softmax(log IG) g (Eq. 15); softmax(log IG) is IG / sum IG, so the argmax is that of IG g.

    Parameters
    ----------
    discovery
        What stands for IG_px, the gain of what is not known yet: ``"pixel"`` (the paper's uncovered pixels),
        ``"hole_area"``, ``"unknown_volume"`` or ``"unseen"``. With one of the others the rungs are a ladder on one
        base: B differs from the policy of that name in the term of the planes alone, every rung from the one below in
        what it adds, and the terms weigh what they weigh in phase I of the full model, which adds the phases.
    """

    travel_term = "the shared one"
    native_settings = SPLATAM
    weights: ClassVar[Weights] = Weights()  # beside pixels
    on_base: ClassVar[Weights] = _ON_BASE  # beside another gain of discovery
    deficiencies: ClassVar[bool] = False  # whether IG_def is a term of it

    def __init__(self, discovery: Discovery = "pixel") -> None:
        super().__init__()
        if discovery not in get_args(Discovery):
            raise InputError(f"option discovery must be {', '.join(get_args(Discovery))}, got '{discovery}'")
        self._discovery, self._discovers = discovery, _DISCOVERY[discovery]
        self._weights = self.weights if discovery == "pixel" else self.on_base
        self.required_features = (*self._discovers, *(("deficiency",) if self.deficiencies else ()))
        self._trace: dict[str, Any] = {}

    def act(self, observation: Observation) -> int:
        """The valid row with the largest product of information gain and travel discount."""
        terms = self.terms(observation, plane_view(observation), self._weights)
        return self._choose(discovering(terms.total, observation), terms, observation, {})

    def terms(self, observation: Observation, planes: PlaneView, weights: Weights) -> GainTerms:
        """The terms of Eqs. 12 to 14; a feature the rung does not ask for counts as 0."""
        candidates = self.candidates(observation)
        shares = {name: candidates[name].astype(np.float64) / unit for name, unit in self._discovers.items()}
        if _SIDES in shares:
            shares[_SIDES] *= weights.sides
        unseen = np.sum(list(shares.values()), axis=0)
        deficiency = candidates["deficiency"].astype(np.float64) if self.deficiencies else np.zeros(len(candidates))
        return information_gain(unseen, deficiency, planes, weights)

    def _choose(self, gain: np.ndarray, terms: GainTerms, observation: Observation, more: dict[str, Any]) -> int:
        travel = travel_discount(observation)
        # Where nothing is left to gain the floor leaves the choice to the distance.
        scores = np.maximum(gain, 1e-6) * travel
        choice = best_valid(scores, observation)
        others = observation["action_mask"].astype(bool)
        others[choice] = False
        self._trace = {**more, "chosen": {**terms.row(choice, self._discovery), "travel": float(travel[choice])}}
        if others.any():
            second = int(np.argmax(np.where(others, scores, -np.inf)))
            named = terms.row(second, self._discovery)
            self._trace["runner_up"] = {"row": second, **named, "travel": float(travel[second])}
        return choice

    def trace(self) -> dict[str, Any]:
        """The terms of the chosen view and of the runner-up, and for the full model the phase."""
        return self._trace


@POLICIES.register("activestructure-a")
class ActiveStructureA(PixelOnly):
    """argmax IG_px g: rung A, pixels only."""

    criterion = "uncovered pixels"
    source = "ActiveStructure, rung A of Table 3"
    native_settings = SPLATAM


@POLICIES.register("activestructure-b")
class ActiveStructureB(StructurePolicy):
    """argmax (IG_px + omega sum alpha_i (1 - q_i)) g: rung B, A and the raw gain of every visible plane."""

    criterion = "uncovered pixels and bad planes in sight"
    source = "ActiveStructure, rung B of Table 3"
    weights = Weights(structural=0.1, objects=0.1, surprise=False)
    on_base = replace(_ON_BASE, surprise=False, max_discount=0.0)


@POLICIES.register("activestructure-c")
class ActiveStructureC(StructurePolicy):
    """argmax (IG_px (1 - rho) + omega sum alpha_i gamma_i) g: rung C, B by anomalies, with the discount of Eq. 12."""

    criterion = "uncovered pixels and anomalous planes in sight"
    source = "ActiveStructure, rung C of Table 3"
    weights = Weights(structural=0.1, objects=0.1, max_discount=0.1)


@POLICIES.register("activestructure-d")
class ActiveStructureD(StructurePolicy):
    """argmax (IG_px (1 - rho) + omega (sum alpha_i gamma_i + omega_d IG_def)) g: rung D, C and deficiency centres."""

    criterion = "uncovered pixels, anomalous planes and their deficiency centres"
    source = "ActiveStructure, rung D of Table 3"
    deficiencies = True
    weights = Weights(structural=0.1, objects=0.1, max_discount=0.1)


@POLICIES.register("activestructure")
class ActiveStructure(StructurePolicy):
    """argmax of the gain of D in three phases, with the reversal of polarity between them: rung E, the full model.

    What is left to discover is counted from the state of the volume, not in uncovered pixels: a pool that is to run
    empty must not hold views through an open window.
    """

    criterion = "unknown space and deficient planes, in three phases"
    source = "ActiveStructure, Sec. 3; rung E of its Table 3"
    deficiencies = True

    def __init__(self, discovery: Discovery = "unknown_volume") -> None:
        super().__init__(discovery)
        self._machine, self._sent, self._mending = PhaseMachine(), SentTo(), Mending()

    def reset(self, seed: int) -> None:
        """Begin with phase I."""
        super().reset(seed)
        self._machine, self._sent, self._mending = PhaseMachine(), SentTo(), Mending()

    def act(self, observation: Observation) -> int:
        """The best view of the present phase; in phase III the nearest of the worst keyframes, while that mends."""
        machine, planes = self._machine, plane_view(observation)
        candidates = self.candidates(observation)
        valid = candidates.valid & ~candidates.revisit
        terms = self.terms(observation, planes, machine.phase.weights)
        pool = in_pool(terms, valid, machine.phase)
        changed = machine.update(pool)
        if changed:
            terms = self.terms(observation, planes, machine.phase.weights)
            pool = in_pool(terms, valid, machine.phase)
        more = {"phase": machine.phase.name, "pool": int(pool.sum()), "changed": changed}
        if machine.phase.refines:
            return self._refine(terms, observation, more)
        gain = np.where(pool, terms.total, 0.0) if pool.any() else terms.total
        return self._choose(discovering(gain, observation), terms, observation, more)

    def _refine(self, terms: GainTerms, observation: Observation, more: dict[str, Any]) -> int:
        """The nearest of the worst rendered keyframes that it was not sent to yet.

        Without one, once nine tenths of all are good, or when revisits no longer mend, the episode is settled, and the
        trace says so: it ends where the environment offers that (source ``finish``), and discovers again where it does
        not.
        """
        candidates = self.candidates(observation)
        views = np.concatenate([candidates.xyz, candidates.view_direction], axis=1)
        open_ = candidates.revisit & candidates.valid & ~self._sent.includes(views)
        lowest = float(observation["fidelity"][0])
        settled = self._settled(bool(open_.any()), lowest)
        more = {**more, "fidelity": lowest, "settled": settled}
        if settled and candidates.offers(_END) and (ending := np.flatnonzero(candidates.source(_END))).size:
            self._trace = more
            return int(ending[0])
        if settled:
            return self._choose(discovering(terms.total, observation), terms, observation, more)
        choice = self._choose(open_.astype(np.float64), terms, observation, more)
        self._sent.add(views[choice])
        return choice

    def _settled(self, left: bool, lowest: float) -> str | None:
        """Why no keyframe is worth a revisit, if none is."""
        if not left:
            return "no keyframe left to revisit"
        if lowest >= GOOD_PSNR:
            return f"nine tenths of the keyframes reach {GOOD_PSNR:g} dB"
        if not self._mending.goes_on(lowest, len(self._sent)):
            return f"{LOT} revisits raised the lowest tenth by less than {MIN_RISE_DB:g} dB"
        return None


# Table 3 in its order; each rung adds one component.
LADDER = ("activestructure-a", "activestructure-b", "activestructure-c", "activestructure-d", "activestructure")
