"""Describe the numbers that the protocol `standard` measures, in the order of the tables."""

from __future__ import annotations

from activestructure_gym.evaluation.protocols.metrics.base import METRICS, Metric

# In a meaning, {near} is the threshold of the protocol.
ACCURACY = Metric(
    "accuracy_cm", "lowest", "Acc", "cm", 2, "mean distance from the reconstructed points to the true surface"
)
COMPLETION = Metric(
    "completion_cm", "lowest", "Com.", "cm", 2,
    "mean distance from the true surface to the reconstructed points; what was missed counts",
)  # fmt: skip
RATIO = Metric(
    "completion_ratio", "highest", "C.R.", "%", 1,
    "completion ratio, the share of the true surface with a point nearer than {near}",
)  # fmt: skip
TSDF_RATIO = Metric(
    "tsdf_completion_ratio", "highest", "C.R. surface", "%", 1,
    "the same of the surface that is fused from the map's own depth at the keyframes; it hardly depends on how densely "
    "Gaussians stand",
)  # fmt: skip
OBSERVED = Metric(
    "observed", "highest", "observed", "%", 1,
    "share of the true surface that any keyframe saw, mapped or not: exploring raises it; high with a low C.R. is seen "
    "and not mapped. C.R. may exceed it, since it reaches a little beyond what was seen",
)  # fmt: skip
PRECISION = Metric(
    "precision", "highest", "Prec.", "%", 1,
    "share of the reconstructed points nearer than {near} to the true surface",
)  # fmt: skip
F_SCORE = Metric("f_score", "highest", "F", "%", 1, "harmonic mean of completion ratio and precision")
PSNR = Metric(
    "psnr", "highest", "PSNR", "dB", 2,
    "how closely rendered views that no policy has chosen match the true ones; 1 dB more is a fifth less squared error",
)  # fmt: skip
SSIM = Metric("ssim", "highest", "SSIM", "", 3, "likeness of structure in the same views; 1 is equal")
MS_SSIM = Metric("ms_ssim", "highest", "MS-SSIM", "", 3, "the same over five scales")
LPIPS = Metric("lpips", "lowest", "LPIPS", "", 3, "distance of the same views as a network sees them")
DEPTH = Metric("depth_l1_cm", "lowest", "Depth", "cm", 2, "mean error of the depth in the same views")

STANDARD = (
    ACCURACY, COMPLETION, RATIO, TSDF_RATIO, OBSERVED, PRECISION, F_SCORE, PSNR, SSIM, MS_SSIM, LPIPS, DEPTH
)  # fmt: skip
SURFACE = (ACCURACY, COMPLETION, RATIO, PRECISION, F_SCORE)  # measured of the TSDF surface, too, as tsdf_NAME

for metric in STANDARD:
    METRICS.register(metric.name)(metric)
