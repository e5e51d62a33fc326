"""Informational polarity reversal: what each phase weighs, and which state of the reconstruction ends it (Sec. 3.4).

No transition looks at the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.policies.activestructure.information_gain import GainTerms, Weights


@dataclass(frozen=True)
class Phase:
    """One phase psi."""

    name: str
    weights: Weights
    pool_share: float = 0.0  # of a view into nothing but the unknown: one that would show less leaves the pool (rho)
    deficit_share: float = np.inf  # in the unit of `hole_area`: a view that would mend so much of what is known stays
    refines: bool = False  # True: keyframes are revisited instead of views being scored


PHASES = (
    # Structural deficit attracts. The scaffold stands when no view is left that would show much of the unknown.
    Phase(
        "I scaffold",
        Weights(structural=0.01, objects=0.003, deficiency=0.1, max_discount=0.1, sides=0.0),
        pool_share=0.05,
    ),
    # The same planes suppress, objects attract (with discovery=unseen their far sides, too); the cap of the discount
    # rises, smaller gaps are worth a view.
    Phase(
        "II objects",
        Weights(structural=-0.003, objects=0.01, deficiency=0.2, max_discount=0.3, suppression=0.3),
        pool_share=0.01,
        deficit_share=0.01,
    ),
    # The keyframes that render worst are revisited, with more iterations.
    Phase("III post-refinement", Weights(structural=0.0, objects=0.0, coupling=0.0, deficiency=0.0), refines=True),
)
PATIENCE = 3  # decisions in a row for which the pool must stay empty: 256 candidates are a draw from a larger pool
GOOD_PSNR = 34.0  # dB, of the keyframes phase III works on (ActiveGAMER's threshold)
LOT = 4  # revisits, as many as a table offers, that together must raise the lowest tenth's PSNR ...
MIN_RISE_DB = 0.25  # ... by so many dB, or there are no more


def in_pool(terms: GainTerms, valid: np.ndarray, phase: Phase) -> np.ndarray:  # [K] bool
    """The views still worth going to: enough uncovered after the discount, or enough deficit (Eq. 12)."""
    pixels = terms.pixel * (1.0 - terms.discount) * terms.suppressed >= phase.pool_share
    return valid & (pixels | (terms.deficiency >= phase.deficit_share))


class PhaseMachine:
    """Moves to the next phase when the pool of the present one has been empty for some decisions."""

    def __init__(self) -> None:
        self.index = 0
        self._empty = 0

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return PHASES[self.index]

    def update(self, pool: np.ndarray) -> str | None:
        """Tell it the present pool [K] bool; returns why the phase changed, if it did."""
        self._empty = 0 if pool.any() else self._empty + 1
        if self._empty < PATIENCE or self.phase.refines:
            return None
        self.index, self._empty = self.index + 1, 0
        return f"no view in the pool for {PATIENCE} decisions"


_SAME_VIEW = 0.01  # metres, and the same of a unit vector: a keyframe's own pose comes back to the last digit or so


class SentTo:
    """Keyframes that phase III was sent to: one that still renders worst afterwards is not mended by going again.

    A view is its position and its direction of looking.
    """

    def __init__(self) -> None:
        self._views: list[np.ndarray] = []

    def add(self, view: np.ndarray) -> None:  # [6] metres, unit vector
        """Note the view that was chosen."""
        self._views.append(np.array(view, dtype=np.float64))

    def includes(self, views: np.ndarray) -> np.ndarray:  # [K, 6] -> [K] bool
        """Which of these views it was sent to."""
        if not self._views:
            return np.zeros(len(views), dtype=bool)
        difference = np.abs(views[:, None] - np.stack(self._views)[None]).max(axis=-1)
        return np.asarray((difference < _SAME_VIEW).any(axis=1))

    def __len__(self) -> int:
        """How often phase III was sent to one."""
        return len(self._views)


class Mending:
    """Whether revisits still mend: habituation of phase III, by what the last few of them brought."""

    def __init__(self) -> None:
        self._before, self._over = -np.inf, False

    def goes_on(self, lowest: float, revisits: int) -> bool:
        """Ask before a revisit, with the lowest tenth's PSNR in dB and how many there were; once over, always over."""
        if not self._over and revisits % LOT == 0:
            self._before, self._over = lowest, lowest < self._before + MIN_RISE_DB
        return not self._over
