"""POp-GS as policies, one for each criterion of optimal design ([popgs]); no travel term.

The formulas stand with the features of the same names: with H the information of the keyframes and h its diagonal,
those of a candidate B and d, and everything in units of the median of H,

- ``popgs_logdet``: log(1 + d / (h + lambda)) (D);
- ``popgs_cov_trace``: 1 / (h + lambda) - 1 / (h + lambda + d) (textbook A, called T in the paper);
- ``popgs_info_trace``: d (textbook T, called A in the paper), a negative control;
- ``popgs_min_eig``: growth of the least entry of the whole map (E), a negative control;
- ``popgs_logdet_block``, ``popgs_cov_trace_block``: the same of H + lambda + B, one 6 x 6 block per Gaussian.

The others are summed over the Gaussians. ``NAME`` maximises that, ``NAME_cov`` adds unseen space: G_cov + lambda_o G_Q.
"""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("popgs_logdet")
class LogDet(Greedy):
    """argmax sum log(1 + d / h), h = H + lambda: D-optimality."""

    criterion = "the volume of the map's uncertainty"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_logdet_cov")
class LogDetCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum log(1 + d / h): D-optimality and unseen space."""

    criterion = "the volume of the map's uncertainty, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet_cov",)


@POLICIES.register("popgs_cov_trace")
class CovTrace(Greedy):
    """argmax sum 1 / h - 1 / (h + d), h = H + lambda: trace of the covariance."""

    criterion = "the sum of the map's variances"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_cov_trace_cov")
class CovTraceCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum 1 / h - 1 / (h + d): trace of the covariance and unseen space."""

    criterion = "the sum of the map's variances, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace_cov",)


@POLICIES.register("popgs_info_trace")
class InfoTrace(Greedy):
    """argmax sum d: trace of the information."""

    criterion = "the sum of the map's information"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_info_trace",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_info_trace_cov")
class InfoTraceCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum d: trace of the information and unseen space."""

    criterion = "the sum of the map's information, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_info_trace_cov",)


@POLICIES.register("popgs_min_eig")
class MinEig(Greedy):
    """argmax min (h + d) - min h, h = H + lambda, both over the whole map: E-optimality."""

    criterion = "the worst known parameter of the map"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_min_eig",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_min_eig_cov")
class MinEigCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = min (h + d) - min h: E-optimality and unseen space."""

    criterion = "the worst known parameter of the map, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_min_eig_cov",)


@POLICIES.register("popgs_logdet_block")
class LogDetBlock(Greedy):
    """argmax sum log det(H + B) - log det H, lambda in H: D-optimality by blocks."""

    criterion = "the volume of the map's uncertainty, by blocks"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet_block",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_logdet_block_cov")
class LogDetBlockCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum log det(H + B) - log det H: by blocks, and unseen space."""

    criterion = "the volume of the map's uncertainty, by blocks, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet_block_cov",)


@POLICIES.register("popgs_cov_trace_block")
class CovTraceBlock(Greedy):
    """argmax sum tr H^-1 - tr (H + B)^-1, lambda in H: trace of the covariance by blocks."""

    criterion = "the sum of the map's variances, by blocks"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace_block",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_cov_trace_block_cov")
class CovTraceBlockCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum tr H^-1 - tr (H + B)^-1: by blocks, and unseen space."""

    criterion = "the sum of the map's variances, by blocks, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace_block_cov",)
