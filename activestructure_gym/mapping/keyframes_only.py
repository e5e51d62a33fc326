"""Keep keyframes without mapping them, for tasks that do not read the Gaussian map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.base import MappingReport
from activestructure_gym.mapping.downsampling import reduced
from activestructure_gym.mapping.keyframe_mapper import KeyframeMapper, checked_frame, report_of

_NO_LOSSES = np.empty((0, 3))


class KeyframesOnly(KeyframeMapper):
    """Store the keyframes of an episode. The map has no Gaussians (``mapper.enabled=false``)."""

    def observe(self, frame: Frame, *, iterations: int | None = None) -> MappingReport:
        """Store the keyframe; ``iterations`` has no effect."""
        self.events += 1
        self._store.append(reduced(checked_frame(frame), self.config.keyframe_reduction), new_share=0.0)
        return report_of(0, [], _NO_LOSSES, 0)

    def refine(self, iterations: int, *, keyframe_indices: Sequence[int] | None = None) -> MappingReport:
        """Do nothing: there is no map to optimise."""
        self.events += 1
        return report_of(0, [], _NO_LOSSES, 0)
