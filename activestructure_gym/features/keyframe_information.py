"""Sum the Fisher information of the keyframes about every Gaussian, incrementally from decision to decision.

FisherRF renders all keyframes at every decision, so its planning time grows with their number. Here the contribution of
each keyframe is stored. A decision renders the new keyframes and those with the oldest contributions, ``renders`` in
all (more if more are new). The sum has these properties:

- Each keyframe counts once, with the map at the time it was last rendered. The sum is exact up to ``renders``
  keyframes; with more, contributions become outdated.
- Removed Gaussians leave the sum at once. A new Gaussian has no contribution from a keyframe until it is rendered.
- If the contributions need more than ``budget_mb``, the oldest become fixed: they remain in the sum and follow
  removals, but are not computed again.

Source: [fisherrf], the H of all training views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from activestructure_gym.features.rows_by_id import RowsById
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.frustum_culling import MapParts
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.splatting.fisher import depth_information, view_information

# The first 24 columns of `ViewInformation.numbers` are summed. They are the 21 entries of the upper triangle of the
# 6 x 6 block of mean and log-scale, then opacity logit, colour (sum of squared weights) and sum of weights.
COLUMNS = 24
RENDERS = 16  # number of keyframes rendered per decision
BUDGET_MB = 256.0  # megabytes, maximum memory of the stored contributions


@dataclass
class _Contribution:
    """Hold the numbers that one keyframe has added to the sum, for the S Gaussians that it sees."""

    ids: np.ndarray  # [S] int64, ids of Gaussians
    numbers: np.ndarray  # [S, 24] float32

    @property
    def bytes(self) -> int:
        return self.ids.nbytes + self.numbers.nbytes


class KeyframeInformation:
    """Sum the first 24 columns of `ViewInformation.numbers` over the keyframes, one row per Gaussian.

    Keyframes are rendered with ``camera``, so that they have the same pixels as the candidates; None means the camera
    of each keyframe. With ``of_depth``, the information is computed from the rendered depth (`depth_information`)
    instead of the colours.
    """

    def __init__(
        self,
        gaussians: GaussianMap,
        *,
        camera: PinholeCamera | None = None,
        of_depth: bool = False,
        budget_mb: float = BUDGET_MB,
    ) -> None:
        if budget_mb <= 0:
            raise ValueError(f"budget_mb must be above 0, got {budget_mb}")
        self._map, self._camera, self._of_depth, self._budget = gaussians, camera, of_depth, budget_mb * 1e6
        self._sum = RowsById(gaussians, COLUMNS)  # float64, since contributions are subtracted again
        self._contributions: dict[int, _Contribution] = {}  # by keyframe, oldest first
        self._bytes = 0
        self._known = 0  # number of keyframes in the sum, including fixed ones

    @property
    def megabytes(self) -> float:
        """Return the memory of the stored contributions in megabytes; at most the budget."""
        return self._bytes / 1e6

    @property
    def fixed(self) -> int:
        """Return the number of fixed keyframes, whose contribution to the sum is no longer stored."""
        return self._known - len(self._contributions)

    def update(
        self,
        keyframes: Sequence[Frame],  # all keyframes, those of the previous call first
        *,
        renders: int | None = RENDERS,
    ) -> np.ndarray:  # [N, 24] float64, one row per Gaussian, valid until the next call
        """Render the new keyframes and those with the oldest contributions, ``renders`` in all, and return the sum.

        ``renders=None`` renders all keyframes that are not fixed. With a constant number of new keyframes per call, the
        cost does not grow with the number of keyframes.
        """
        if len(keyframes) < self._known:
            raise ValueError(f"expected the {self._known} keyframes of the last call and more, got {len(keyframes)}")
        if renders is not None and renders < 0:
            raise ValueError(f"renders must not be negative, got {renders}")
        self._sum.follow()
        new = list(range(self._known, len(keyframes)))
        old = len(self._contributions) if renders is None else max(0, renders - len(new))
        oldest = [index for index, _ in zip(self._contributions, range(old))]
        parts = MapParts(self._map) if len(new) + len(oldest) > 3 else None
        for index in oldest + new:
            self._measure(index, keyframes[index], parts)
        self._known = len(keyframes)
        self._limit_memory()
        return self._sum.values

    def _measure(self, index: int, frame: Frame, parts: MapParts | None) -> None:
        camera, pose = self._camera or frame.camera, frame.world_from_camera
        unseen = parts.unseen(camera, pose) if parts else None
        if self._of_depth:
            seen = depth_information(self._map.parameters, self._map.count, camera, pose, unseen=unseen)
        else:
            (seen,) = view_information(self._map.parameters, self._map.count, camera, pose, unseen=unseen)
        before = self._contributions.pop(index, None)
        if before is not None:
            rows = self._sum.rows_of(before.ids)
            there = rows >= 0
            self._sum.values[rows[there]] -= before.numbers[there]
            self._bytes -= before.bytes
        added = _Contribution(self._map.ids[seen.indices], seen.numbers[:, :COLUMNS].copy())
        self._sum.values[seen.indices] += added.numbers
        self._contributions[index] = added  # the dictionary is ordered from the oldest to the newest contribution
        self._bytes += added.bytes

    def _limit_memory(self) -> None:
        while self._bytes > self._budget:
            self._bytes -= self._contributions.pop(next(iter(self._contributions))).bytes
