"""Fisher information of the keyframes about every Gaussian: the sum of their blocks, kept between decisions.

FisherRF renders all keyframes at every planning step, so planning takes longer with every keyframe. Here the share of
each keyframe is stored, and at every decision only the ones that have no share yet are rendered, and of the others the
stalest, ``renders`` in all (more only if more are new). What that means for the sum:

- it counts every keyframe once, each with the map as it was when that keyframe was last rendered: up to ``renders``
  keyframes it is exact, beyond that shares grow old as fast as new keyframes take their place in the ``renders``;
- Gaussians that were removed are gone from it at once, those that are new have nothing from a keyframe until its turn;
- when the shares outgrow ``budget_mb``, the stalest are settled: they stay in the sum as they are (and follow removals)
  but cannot be measured anew.

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

COLUMNS = 24  # of `ViewInformation.numbers`: the block's 21, opacity logit, squared weights (colour), weights
RENDERS = 16  # of keyframes per decision
BUDGET_MB = 256.0


@dataclass
class _Share:
    """The blocks that one keyframe has added to the sum."""

    ids: np.ndarray  # [S] int64 of Gaussians
    numbers: np.ndarray  # [S, 24] float32

    @property
    def bytes(self) -> int:
        return self.ids.nbytes + self.numbers.nbytes


class KeyframeInformation:
    """The sum over the keyframes of the first 24 columns of `ViewInformation.numbers`, row by row as the map's columns.

    ``camera`` is the one the keyframes are rendered with: that of the candidates, so that both count the same pixels;
    without it each keyframe's own. ``of_depth`` asks about the rendered depth (`depth_information`).
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
        self._sum = RowsById(gaussians, COLUMNS)  # float64, since shares are taken out again
        self._shares: dict[int, _Share] = {}  # by keyframe, the stalest first
        self._bytes = 0
        self._known = 0  # keyframes that are in the sum, settled ones too

    @property
    def megabytes(self) -> float:
        """Megabytes of all stored shares; at most the budget."""
        return self._bytes / 1e6

    @property
    def settled(self) -> int:
        """Keyframes whose share can no longer be measured anew."""
        return self._known - len(self._shares)

    def update(
        self,
        keyframes: Sequence[Frame],  # all of them; a longer list than the last one's, or the same
        *,
        renders: int | None = RENDERS,
    ) -> np.ndarray:  # [N, 24] float64, one row per Gaussian, a view until the next call
        """Measure the keyframes that have no share yet and up to ``renders`` keyframes in all, the stalest first.

        ``renders=None`` measures all that are not settled. In a steady state the cost does not grow with the number of
        keyframes.
        """
        if len(keyframes) < self._known:
            raise ValueError(f"expected the {self._known} keyframes of the last call and more, got {len(keyframes)}")
        if renders is not None and renders < 0:
            raise ValueError(f"renders must not be negative, got {renders}")
        self._sum.follow()
        new = list(range(self._known, len(keyframes)))
        old = len(self._shares) if renders is None else max(0, renders - len(new))
        stalest = [index for index, _ in zip(self._shares, range(old))]
        parts = MapParts(self._map) if len(new) + len(stalest) > 3 else None
        for index in stalest + new:
            self._measure(index, keyframes[index], parts)
        self._known = len(keyframes)
        self._settle()
        return self._sum.values

    def _measure(self, index: int, frame: Frame, parts: MapParts | None) -> None:
        camera, pose = self._camera or frame.camera, frame.world_from_camera
        unseen = parts.unseen(camera, pose) if parts else None
        if self._of_depth:
            seen = depth_information(self._map.parameters, self._map.count, camera, pose, unseen=unseen)
        else:
            (seen,) = view_information(self._map.parameters, self._map.count, camera, pose, unseen=unseen)
        before = self._shares.pop(index, None)
        if before is not None:
            rows = self._sum.rows_of(before.ids)
            there = rows >= 0
            self._sum.values[rows[there]] -= before.numbers[there]
            self._bytes -= before.bytes
        share = _Share(self._map.ids[seen.indices], seen.numbers[:, :COLUMNS].copy())
        self._sum.values[seen.indices] += share.numbers
        self._shares[index] = share  # the last one is the freshest
        self._bytes += share.bytes

    def _settle(self) -> None:
        while self._bytes > self._budget:
            self._bytes -= self._shares.pop(next(iter(self._shares))).bytes
