"""Define the three phases of informational polarity reversal (Sec. 3.4): their weights, and when they end.

No transition between phases depends on the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.policies.activestructure.information_gain import GainTerms, Weights
from activestructure_gym.policies.base import patience


@dataclass(frozen=True)
class Phase:
    """Define one phase (psi in the paper): its weights, the views in its pool, and whether it revisits keyframes."""

    name: str
    weights: Weights
    # Minimum discovery gain of a view in the pool, times the travel discount g; 1 is the gain of a view at the agent's
    # place that sees only unknown space.
    pool_share: float = 0.0
    deficit_share: float = np.inf  # minimum IG_def with which any view is in the pool, in the unit of `hole_area`
    refines: bool = False  # True: revisit keyframes instead of scoring views


PHASES = (
    # Structural planes with a deficit raise the gain. The phase ends when no view would show much unknown space.
    Phase(
        "I scaffold",
        Weights(structural=0.01, objects=0.003, deficiency=0.1, max_discount=0.1, sides=0.0),
        pool_share=0.03,
    ),
    # Structural planes lower the gain, and objects raise it (with discovery=unseen also their unseen sides). The cap of
    # the discount is higher, and the pool includes views of smaller gaps.
    Phase(
        "II objects",
        Weights(structural=-0.003, objects=0.01, deficiency=0.2, max_discount=0.3, suppression=0.3),
        pool_share=0.012,
        deficit_share=0.01,
    ),
    # The keyframes with the lowest PSNR are revisited and get more iterations.
    Phase("III post-refinement", Weights(structural=0.0, objects=0.0, coupling=0.0, deficiency=0.0), refines=True),
)
GOOD_PSNR = 34.0  # dB; phase III ends when 90 % of the keyframes reach it (ActiveGAMER's threshold)
LOT = 4  # number of revisits between two tests of progress; a table offers at most as many
MIN_RISE_DB = 0.25  # dB by which LOT revisits must raise the 10 % quantile of the keyframes' PSNR


def in_pool(
    discovered: np.ndarray,  # [K] discovery gain of each view alone, without its path; 1: it sees only unknown space
    terms: GainTerms,
    travel: np.ndarray,  # [K] travel discount g in (0, 1]
    valid: np.ndarray,  # [K] bool
    phase: Phase,
) -> np.ndarray:  # [K] bool
    """Return which ``valid`` views are in the pool of the phase.

    A view needs a discovery gain of at least ``pool_share``, after the discount (Eq. 12) and the travel discount (Eq.
    15), or an IG_def of at least ``deficit_share``. The gain of a whole path grows with the size of the scene, and so
    does the largest gain of many views. With the gain of a single view per frame of travel, a phase ends at about the
    same share of the surface in scenes of any size (docs/notebook/lab_notes.md).
    """
    enough = discovered * (1.0 - terms.discount) * terms.suppressed * travel >= phase.pool_share
    return valid & (enough | (terms.deficiency >= phase.deficit_share))


class PhaseMachine:
    """Hold the current phase; switch to the next one after successive decisions with an empty pool (`patience`)."""

    def __init__(self) -> None:
        self.index = 0
        self._empty = 0

    @property
    def phase(self) -> Phase:
        """Return the current phase."""
        return PHASES[self.index]

    def update(self, pool: np.ndarray) -> str | None:
        """Count a decision with the views ``pool`` [K] bool; return the reason if the phase changed, else None."""
        self._empty = 0 if pool.any() else self._empty + 1
        needed = patience(len(pool))
        if self._empty < needed or self.phase.refines:
            return None
        self.index, self._empty = self.index + 1, 0
        return f"no view in the pool for {needed} decisions"


_SAME_VIEW = 0.01  # metres, and components of a unit vector; revisit rows repeat a keyframe's pose up to rounding


class RevisitedViews:
    """Record the keyframes that phase III has revisited, since a second revisit rarely raises their PSNR.

    A keyframe is identified by its position and view direction.
    """

    def __init__(self) -> None:
        self._views: list[np.ndarray] = []

    def add(self, view: np.ndarray) -> None:  # [6] metres, unit vector
        """Record a revisited keyframe by its position (metres) and view direction."""
        self._views.append(np.array(view, dtype=np.float64))

    def includes(self, views: np.ndarray) -> np.ndarray:  # [K, 6] -> [K] bool
        """Return which of the views were revisited; each row is a position (metres) and a view direction."""
        if not self._views:
            return np.zeros(len(views), dtype=bool)
        difference = np.abs(views[:, None] - np.stack(self._views)[None]).max(axis=-1)
        return np.asarray((difference < _SAME_VIEW).any(axis=1))

    def __len__(self) -> int:
        """Return the number of revisits."""
        return len(self._views)


class RevisitProgress:
    """Test after every four revisits whether they raised the PSNR by at least 0.25 dB; otherwise phase III ends."""

    def __init__(self) -> None:
        self._before, self._over = -np.inf, False

    def continues(self, lowest: float, revisits: int) -> bool:
        """Return whether phase III continues with another revisit; once False, the result stays False.

        ``lowest`` is the 10 % quantile of the keyframes' PSNR in dB, ``revisits`` the number of revisits so far.
        """
        if not self._over and revisits % LOT == 0:
            self._before, self._over = lowest, lowest < self._before + MIN_RISE_DB
        return not self._over
