"""Compute the information gain of candidates from the Plane Scene Graph (Eqs. 11 to 14) by pure functions.

Shapes: K candidates, P rows of planes. Rows without a plane are visible from no candidate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.envs.observation import plane_columns
from activestructure_gym.policies.candidates import Observation, check_observation
from activestructure_gym.policies.scored import FACTOR


@dataclass(frozen=True)
class PlaneView:
    """Hold the P planes of an observation, and which of them each of K candidates sees."""

    visible: np.ndarray  # [K, P] bool, V_c^vis
    quality: np.ndarray  # [P] q_i, Eq. 7
    surprise: np.ndarray  # [P] Phi_i
    deficit: np.ndarray  # [P] gamma_i = (1 - q_i) Phi_i, Eq. 10
    structural: np.ndarray  # [P] bool, V_S, Eq. 5
    area: np.ndarray  # [P] m^2


def plane_view(observation: Observation) -> PlaneView:
    """Return the planes of an observation; rows without a plane are invisible and have no area."""
    check_observation(observation)
    mask = observation["plane_mask"].astype(bool)
    columns = plane_columns("quality", "surprise", "deficit", "structural", "area")
    quality, surprise, deficit, structural, area = observation["plane_features"][:, columns].astype(np.float64).T
    return PlaneView(
        visible=observation["candidate_planes"].astype(bool) & mask,
        quality=np.where(mask, quality, 1.0),
        surprise=np.where(mask, surprise, 0.0),
        deficit=np.where(mask, deficit, 0.0),
        structural=(structural > 0) & mask,
        area=np.where(mask, area, 0.0),
    )


@dataclass(frozen=True)
class Weights:
    """Define the weights of the terms of the information gain, for a phase or for a variant of Table 3."""

    structural: float = 1.0  # alpha_i of planes in V_S, Eq. 13
    objects: float = 1.0  # alpha_i of planes in V_O, Eq. 13
    coupling: float = 1.0  # omega, Eqs. 1 and 14
    deficiency: float = 1.0  # omega_d, Eq. 13
    max_discount: float = 0.0  # rho_max, Eq. 12
    suppression: float = 0.0  # 0..1, strength of `suppression`, for views of well-reconstructed planes (phase II)
    surprise: bool = True  # False: gamma_i is replaced by 1 - q_i (variant B of Table 3)
    sides: float = 1.0  # weight of unseen sides, if the discovery gain includes them


@dataclass(frozen=True)
class GainTerms:
    """Hold the terms of the information gain (Eqs. 12 to 14) of K candidates, [K] each."""

    pixel: np.ndarray  # IG_px, or another discovery gain
    discount: np.ndarray  # rho_c in [0, rho_max]
    structure: np.ndarray  # sum of alpha_i gamma_i over the visible planes, divided by the sum of gamma over all planes
    deficiency: np.ndarray  # IG_def
    floor: np.ndarray  # `VISIBILITY_FLOOR` for views that see a plane, else 0
    suppressed: np.ndarray  # factor on the whole gain in [0, 1], see `suppression`; 1 outside phase II
    total: np.ndarray  # IG, floored at 0

    def row(self, index: int, discovery: str) -> dict[str, float]:
        """Return the terms of one candidate for a trace; ``discovery`` is the name of the gain used as IG_px."""
        names = {"pixel": discovery, "floor": "visibility floor"}
        return {names.get(name, name): float(values[index]) for name, values in vars(self).items()}

    def summands(self, discovery: str, weights: Weights) -> dict[str, np.ndarray]:  # [K] each
        """Return the weighted terms of Eq. 14, which add up to IG before the factor of `suppression`, and that factor.

        ``discovery`` is the name of the gain used as IG_px.
        """
        return {
            discovery: self.pixel * (1.0 - self.discount),
            "planes": weights.coupling * self.structure,
            "weighted deficiency": weights.coupling * weights.deficiency * self.deficiency,
            "visibility floor": weights.coupling * self.floor,
            f"{FACTOR}suppression": self.suppressed,
        }


VISIBILITY_FLOOR = 1e-4  # added to the gain of a view that sees any tracked plane (Sec. 3.4)
GOOD_QUALITY = 0.8  # minimum quality q (0..1) of a well-reconstructed structural plane
BLEND = 0.5  # eta of Eq. 11: weight of the mean surprise; the maximum has the rest
DISCOUNT_PLANES = 3.0  # number of visible planes at which the discount is 1 - 1/e of its cap


def information_gain(
    pixel: np.ndarray,  # [K] IG_px: share of uncovered pixels, or another discovery gain (`StructurePolicy`)
    deficiency: np.ndarray,  # [K] IG_def in 0..1
    planes: PlaneView,
    weights: Weights,
) -> GainTerms:
    """Return IG = IG_px (1 - rho) + omega (sum alpha_i gamma_i + omega_d IG_def), at least 0 (Eqs. 12 to 14)."""
    rho = discount(planes, weights.max_discount)
    structure = structural_term(planes, weights)
    floor = np.where(planes.visible.any(axis=1), VISIBILITY_FLOOR, 0.0)
    kept = suppression(planes, weights.suppression)
    total = pixel * (1.0 - rho) + weights.coupling * (structure + weights.deficiency * deficiency + floor)  # Eq. 14
    return GainTerms(pixel, rho, structure, deficiency, floor, kept, np.maximum(total * kept, 0.0))


def structural_term(planes: PlaneView, weights: Weights) -> np.ndarray:  # [K]
    """Return sum of alpha_i gamma_i over the visible planes (Eq. 13), divided by the sum of gamma over all planes.

    The division keeps the term in [-1, 1] for any number of planes and any scale of the surprises. IG_px and IG_def are
    shares too.
    """
    missing = planes.deficit if weights.surprise else 1.0 - planes.quality
    alpha = np.where(planes.structural, weights.structural, weights.objects)
    return planes.visible @ (alpha * missing) / max(float(missing.sum()), 1e-12)


def view_surprise(planes: PlaneView) -> np.ndarray:  # [K], 0 for a view without planes
    """Return the surprise Phi_c of each candidate: 0.5 mean + 0.5 maximum of Phi over its visible planes (Eq. 11)."""
    seen = np.where(planes.visible, planes.surprise, 0.0)
    mean = seen.sum(axis=1) / np.maximum(planes.visible.sum(axis=1), 1)
    return BLEND * mean + (1.0 - BLEND) * seen.max(axis=1, initial=0.0)  # Eq. 11


def discount(planes: PlaneView, cap: float) -> np.ndarray:  # [K] rho_c in [0, cap]
    """Return rho_c of Eq. 12 = cap (1 - exp(-n / 3)) (1 - Phi_c / max Phi) (mean q of the n visible planes).

    ``cap`` is rho_max, Phi_c is `view_surprise`, and max Phi its maximum over the rows of the table. The paper only
    states that rho_c grows with the visible tracked planes and inversely with their structural deficit. Here quality
    and surprise, the factors of the deficit, take its place.
    """
    count = planes.visible.sum(axis=1)
    surprise = view_surprise(planes)
    largest = max(float(surprise.max(initial=0.0)), 1e-12)
    quality = (planes.visible @ planes.quality) / np.maximum(count, 1)
    return cap * (1.0 - np.exp(-count / DISCOUNT_PLANES)) * (1.0 - surprise / largest) * quality


def suppression(planes: PlaneView, strength: float) -> np.ndarray:  # [K] factor in [1 - strength, 1]
    """Return a factor on the gain of each candidate, 1 - strength x s.

    s is the share of well-reconstructed structural planes in the area of all planes that the candidate sees. The factor
    applies the polarity reversal of phase II to whole views (Sec. 3.4).
    """
    if not strength:
        return np.ones(len(planes.visible))
    area = planes.visible @ planes.area
    done = planes.visible @ (planes.area * (planes.structural & (planes.quality >= GOOD_QUALITY)))
    return 1.0 - strength * done / np.maximum(area, 1e-12)
