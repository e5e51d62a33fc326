"""Compute the metrics that need no ground truth: known volume, and the image quality of keyframes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.evaluation.protocols.metrics.base import Metric
from activestructure_gym.evaluation.protocols.metrics.standard import STANDARD, SURFACE

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction

NO_TRUTH = "no ground truth"
KNOWN_VOLUME = Metric(
    "known_m3", "highest", "known", "m³", 1, "volume known to be free or occupied; it measures exploration"
)
KEYFRAME_PSNR = Metric(
    "keyframe_psnr", "highest", "keyframe PSNR", "dB", 2,
    "median PSNR of the keyframes when last rendered: views that were mapped, not held-out ones",
)  # fmt: skip
WITHOUT_TRUTH = (KNOWN_VOLUME, KEYFRAME_PSNR)


def measured_without_truth(reconstruction: Reconstruction) -> dict[str, float | None]:
    """Return the metrics of `WITHOUT_TRUTH` by name."""
    from activestructure_gym.envs.reward import known_volume

    psnr = reconstruction.mapper.keyframe_psnr(renders=0)
    return {
        KNOWN_VOLUME.name: known_volume(reconstruction.volume),
        KEYFRAME_PSNR.name: float(np.median(psnr)) if len(psnr) else None,
    }


def unmeasured() -> dict[str, Any]:
    """Return the metrics of the protocol `standard` as None, each with the reason in ``notes``."""
    names = [*(metric.name for metric in STANDARD), *(f"tsdf_{metric.name}" for metric in SURFACE)]
    none: dict[str, Any] = dict.fromkeys([*names, "view_coverage", "lpips_weights", "true_area_m2", "true_samples"])
    return none | {"views": [], "notes": dict.fromkeys([*names, "tsdf"], NO_TRUTH)}
