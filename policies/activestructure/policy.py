"""Define the policies of ActiveStructure: Eq. 15, the phases, and the variants A to E of Table 3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
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
    PhaseMachine,
    RevisitedViews,
    RevisitProgress,
    in_pool,
)
from activestructure_gym.policies.base import POLICIES, Observation, Policy, best_valid, travel_discount
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.native_settings import SPLATAM
from activestructure_gym.policies.pixel_only.policy import PixelOnly
from activestructure_gym.policies.scored import FACTOR
from activestructure_gym.policies.unseen.policy import SIDE_DEPTH

Discovery = Literal["pixel", "hole_area", "unknown_volume", "unseen"]
_SIDES, _END = "unseen_sides", "finish"
_ON_BASE = replace(PHASES[0].weights, sides=1.0)
# The feature columns used as IG_px for each discovery gain, and their scales: a column divided by its scale is IG_px.
# The scale is 1 for `pixel` and `hole_area`, which are shares. For volumes (m^3), the scale is the gain of a view that
# sees only unknown space. This is the solid angle of 1.42 sr (90 x 59 degrees) times the integral of r^2 exp(-r) from 0
# to 6 m. On the voxel grid, where rays miss some voxels, such a view has 2.2 m^3.
_DISCOVERY: dict[Discovery, dict[str, float]] = {
    "pixel": {"pixel": 1.0},
    "hole_area": {"hole_area": 1.0},
    "unknown_volume": {"unknown_volume_way": 2.7},
    "unseen": {"unknown_volume_way": 2.7, _SIDES: 2.7 / SIDE_DEPTH},
}
# The columns that hold the gain of a view alone instead of its path's, by the column in `_DISCOVERY`.
_OF_VIEW = {"unknown_volume_way": "unknown_volume"}


def without_revisit_gain(gain: np.ndarray, observation: Observation) -> np.ndarray:  # [K]
    """Return the gain [K], set to 0 for revisits of keyframes.

    A keyframe always sees its own planes and would have a gain; revisits are chosen in phase III only.
    """
    return np.where(Candidates(observation).revisit, 0.0, gain)


class StructurePolicy(Policy):
    """Choose T* = argmax softmax(log IG) g (Eq. 15). This is argmax IG g, since softmax(log IG) is IG / sum IG.

    Parameters
    ----------
    discovery
        The gain of unknown space, used as IG_px: ``"pixel"`` (the paper's uncovered pixels), ``"hole_area"``,
        ``"unknown_volume"`` or ``"unseen"``. The gains other than ``"pixel"`` are the gains of the policies of the same
        name. With them, each of the variants B, C and D adds one term, with the weights of phase I of the full model.
    """

    travel_term = "the shared one"
    native_settings = SPLATAM
    weights: ClassVar[Weights] = Weights()  # weights with discovery="pixel"
    on_base: ClassVar[Weights] = _ON_BASE  # weights with another discovery gain
    deficiencies: ClassVar[bool] = False  # whether the gain includes IG_def

    def __init__(self, discovery: Discovery = "pixel") -> None:
        """Store the discovery gain; raise `InputError` for an unknown one."""
        super().__init__()
        if discovery not in get_args(Discovery):
            raise InputError(f"option discovery must be {', '.join(get_args(Discovery))}, got '{discovery}'")
        self._discovery, self._discovers = discovery, _DISCOVERY[discovery]
        self._weights = self.weights if discovery == "pixel" else self.on_base
        self.required_features = (*self._discovers, *(("deficiency",) if self.deficiencies else ()))
        self._trace: dict[str, Any] = {}

    def act(self, observation: Observation) -> int:
        """Return the valid row with the largest product of information gain and travel discount."""
        terms = self.terms(observation, plane_view(observation), self._weights)
        return self._choose(without_revisit_gain(terms.total, observation), terms, observation, {}, self._weights)

    def terms(self, observation: Observation, planes: PlaneView, weights: Weights) -> GainTerms:
        """Return the terms of Eqs. 12 to 14 for all candidates; the deficiency IG_def is 0 in variants A to C."""
        candidates = self.candidates(observation)
        unseen = self._discovered(candidates, weights)
        deficiency = candidates["deficiency"].astype(np.float64) if self.deficiencies else np.zeros(len(candidates))
        return information_gain(unseen, deficiency, planes, weights)

    def _discovered(
        self, candidates: Candidates, weights: Weights, columns: Mapping[str, str] = MappingProxyType({})
    ) -> np.ndarray:  # [K]
        """Return the discovery gain in the unit of IG_px; ``columns`` names columns that replace others."""
        shares = {
            name: candidates[columns.get(name, name)].astype(np.float64) / unit
            for name, unit in self._discovers.items()
        }
        if _SIDES in shares:
            shares[_SIDES] *= weights.sides
        return np.asarray(np.sum(list(shares.values()), axis=0))

    def _choose(
        self,
        gain: np.ndarray,
        terms: GainTerms,
        observation: Observation,
        more: dict[str, Any],
        weights: Weights | None = None,
    ) -> int:
        """Return the valid row with the largest product of ``gain`` [K] and travel discount.

        The trace records ``more``, and the ``terms`` of the chosen and of the second best view. With ``weights``, the
        weighted terms explain the gain.
        """
        travel = travel_discount(observation)
        # The lower bound leaves the choice to the travel discount if no view has a gain.
        scores = np.maximum(gain, 1e-6) * travel
        summands = {} if weights is None else terms.summands(self._discovery, weights)
        choice = best_valid(scores, observation, {**summands, f"{FACTOR}travel": travel})
        others = observation["action_mask"].astype(bool)
        others[choice] = False
        self._trace = {**more, "chosen": {**terms.row(choice, self._discovery), "travel": float(travel[choice])}}
        if others.any():
            second = int(np.argmax(np.where(others, scores, -np.inf)))
            named = terms.row(second, self._discovery)
            self._trace["runner_up"] = {"row": second, **named, "travel": float(travel[second])}
        return choice

    def trace(self) -> dict[str, Any]:
        """Return the terms of the chosen view and of the second best, and the phase of the full model."""
        return self._trace


@POLICIES.register("activestructure-a")
class ActiveStructureA(PixelOnly):
    """Choose argmax IG_px g: variant A of Table 3, uncovered pixels IG_px times travel discount g only."""

    criterion = "uncovered pixels"
    source = "ActiveStructure, variant A of Table 3"
    native_settings = SPLATAM


@POLICIES.register("activestructure-b")
class ActiveStructureB(StructurePolicy):
    """Choose argmax (IG_px + omega sum alpha_i (1 - q_i)) g: variant B, which adds the low quality q_i of planes."""

    criterion = "uncovered pixels and visible planes of low quality"
    source = "ActiveStructure, variant B of Table 3"
    weights = Weights(structural=0.1, objects=0.1, surprise=False)
    on_base = replace(_ON_BASE, surprise=False, max_discount=0.0)


@POLICIES.register("activestructure-c")
class ActiveStructureC(StructurePolicy):
    """Choose argmax (IG_px (1 - rho) + omega sum alpha_i gamma_i) g: variant C, with deficits and the discount."""

    criterion = "uncovered pixels and visible anomalous planes"
    source = "ActiveStructure, variant C of Table 3"
    weights = Weights(structural=0.1, objects=0.1, max_discount=0.1)


@POLICIES.register("activestructure-d")
class ActiveStructureD(StructurePolicy):
    """Choose argmax (IG_px (1 - rho) + omega (sum alpha_i gamma_i + omega_d IG_def)) g: variant D, with IG_def."""

    criterion = "uncovered pixels, anomalous planes and their deficiency centres"
    source = "ActiveStructure, variant D of Table 3"
    deficiencies = True
    weights = Weights(structural=0.1, objects=0.1, max_discount=0.1)


@POLICIES.register("activestructure")
class ActiveStructure(StructurePolicy):
    """Choose argmax of the gain of variant D in three phases with polarity reversal: variant E, the full model.

    By default the discovery gain is the unknown volume instead of uncovered pixels. A phase ends when its pool is
    empty, and uncovered pixels would keep views through open windows in the pool. The pool has the views that would
    show much unknown space themselves, for the frames that the path to them costs.

    Parameters
    ----------
    discovery
        The gain of unknown space, as in `StructurePolicy`.
    revisits
        Whether phase III revisits the keyframes with the lowest PSNR, as in the paper. By default it continues to
        explore instead, because revisits cost observed surface and do not raise the PSNR.
    """

    criterion = "unknown space and deficient planes, in three phases"
    source = "ActiveStructure, Sec. 3; variant E of its Table 3"
    deficiencies = True

    def __init__(self, discovery: Discovery = "unknown_volume", revisits: bool = False) -> None:
        super().__init__(discovery)
        self._revisits = revisits
        self.required_features += tuple(_OF_VIEW[name] for name in self._discovers if name in _OF_VIEW)
        self._machine, self._revisited, self._progress = PhaseMachine(), RevisitedViews(), RevisitProgress()

    def reset(self, seed: int) -> None:
        """Begin with phase I."""
        super().reset(seed)
        self._machine, self._revisited, self._progress = PhaseMachine(), RevisitedViews(), RevisitProgress()

    def act(self, observation: Observation) -> int:
        """Return the best view of the current phase; phase III may return a revisit of the worst keyframe instead."""
        machine, planes = self._machine, plane_view(observation)
        candidates = self.candidates(observation)
        valid = candidates.valid & ~candidates.revisit
        terms = self.terms(observation, planes, machine.phase.weights)
        pool = self._pool(observation, terms, valid)
        changed = machine.update(pool)
        if changed:
            terms = self.terms(observation, planes, machine.phase.weights)
            pool = self._pool(observation, terms, valid)
        more = {"phase": machine.phase.name, "pool": int(pool.sum()), "changed": changed}
        if machine.phase.refines:
            return self._refine(terms, observation, more)
        gain = np.where(pool, terms.total, 0.0) if pool.any() else terms.total
        return self._choose(without_revisit_gain(gain, observation), terms, observation, more, machine.phase.weights)

    def _pool(self, observation: Observation, terms: GainTerms, valid: np.ndarray) -> np.ndarray:  # [K] bool
        """Return which ``valid`` views [K] are in the pool of the current phase."""
        phase = self._machine.phase
        discovered = self._discovered(self.candidates(observation), phase.weights, _OF_VIEW)
        return in_pool(discovered, terms, travel_discount(observation), valid, phase)

    def _refine(self, terms: GainTerms, observation: Observation, more: dict[str, Any]) -> int:
        """Return the nearest of the offered keyframes that was not revisited yet.

        The env offers the worst keyframes (`views.max_revisits`). The episode is settled if none of them is left, if
        90 % of the keyframes are good, or if revisits no longer raise the PSNR; the trace contains the reason. A
        settled episode ends if the env has the source ``finish``. Otherwise views are scored again.
        """
        candidates = self.candidates(observation)
        views = np.concatenate([candidates.xyz, candidates.view_direction], axis=1)
        open_ = candidates.revisit & candidates.valid & ~self._revisited.includes(views)
        lowest = float(observation["fidelity"][0])
        settled = self._settled(bool(open_.any()), lowest)
        more = {**more, "fidelity": lowest, "settled": settled}
        if settled and candidates.offers(_END) and (ending := np.flatnonzero(candidates.source(_END))).size:
            self._trace = more
            return int(ending[0])
        if settled:
            gain, weights = without_revisit_gain(terms.total, observation), self._machine.phase.weights
            return self._choose(gain, terms, observation, more, weights)
        choice = self._choose(open_.astype(np.float64), terms, observation, more)
        self._revisited.add(views[choice])
        return choice

    def _settled(self, left: bool, lowest: float) -> str | None:
        """Return the reason to end the revisits, or None.

        ``left`` is whether an offered keyframe is left, ``lowest`` the 10 % quantile of the keyframes' PSNR in dB.
        """
        if not self._revisits:
            return "no revisits (revisits=false)"
        if not left:
            return "the worst keyframes have been revisited"
        if lowest >= GOOD_PSNR:
            return f"nine tenths of the keyframes reach {GOOD_PSNR:g} dB"
        if not self._progress.continues(lowest, len(self._revisited)):
            return f"{LOT} revisits raised the lowest tenth by less than {MIN_RISE_DB:g} dB"
        return None


# The variants in the order of Table 3; each adds one component.
LADDER = (
    "activestructure-a",
    "activestructure-b",
    "activestructure-c",
    "activestructure-d",
    "activestructure?discovery=pixel&revisits=true",
)
