"""Describe the metrics of the protocol `standard` in the order of the tables."""

from __future__ import annotations

from activestructure_gym.evaluation.protocols.metrics.base import METRICS, Metric

# {near} in a meaning is replaced by the protocol's threshold.
ACCURACY = Metric(
    "accuracy_cm", "lowest", "Acc", "cm", 2, "accuracy: mean distance from the reconstructed points to the true surface"
)
COMPLETION = Metric(
    "completion_cm", "lowest", "Com.", "cm", 2,
    "completion: mean distance from the true surface to the reconstructed points; missing parts count",
)  # fmt: skip
RATIO = Metric(
    "completion_ratio", "highest", "C.R.", "%", 1,
    "completion ratio: share of the true surface within {near} of a reconstructed point",
)  # fmt: skip
TSDF_RATIO = Metric(
    "tsdf_completion_ratio", "highest", "C.R. surface", "%", 1,
    "completion ratio of the surface fused from depth rendered at the keyframes; it hardly depends on the density of "
    "Gaussians",
)  # fmt: skip
OBSERVED = Metric(
    "observed", "highest", "observed", "%", 1,
    "share of the true surface visible in at least one keyframe; it measures exploration. C.R. may exceed it, since "
    "C.R. counts points up to {near} away",
)  # fmt: skip
PRECISION = Metric(
    "precision", "highest", "Prec.", "%", 1,
    "precision: share of the reconstructed points within {near} of the true surface",
)  # fmt: skip
F_SCORE = Metric("f_score", "highest", "F", "%", 1, "F-score: harmonic mean of completion ratio and precision")
PSNR = Metric(
    "psnr", "highest", "PSNR", "dB", 2,
    "peak signal-to-noise ratio of rendered held-out views; 1 dB more is 21 % less squared error",
)  # fmt: skip
SSIM = Metric("ssim", "highest", "SSIM", "", 3, "structural similarity of the same views; 1 means equal")
MS_SSIM = Metric("ms_ssim", "highest", "MS-SSIM", "", 3, "structural similarity over five scales")
LPIPS = Metric("lpips", "lowest", "LPIPS", "", 3, "distance of the same views in features of a neural network")
DEPTH = Metric("depth_l1_cm", "lowest", "Depth", "cm", 2, "mean absolute depth error in the same views")

STANDARD = (
    ACCURACY, COMPLETION, RATIO, TSDF_RATIO, OBSERVED, PRECISION, F_SCORE, PSNR, SSIM, MS_SSIM, LPIPS, DEPTH
)  # fmt: skip
SURFACE = (ACCURACY, COMPLETION, RATIO, PRECISION, F_SCORE)  # also measured on the TSDF surface, as tsdf_NAME

for metric in STANDARD:
    METRICS.register(metric.name)(metric)
