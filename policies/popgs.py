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
from activestructure_gym.policies.schedule import SELECTED_VIEWS


@POLICIES.register("popgs_logdet")
class LogDet(Greedy):
    """D-optimality."""

    decides_by = "the volume of the map's uncertainty"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_logdet",)
    brings = SELECTED_VIEWS


@POLICIES.register("popgs_logdet_cov")
class LogDetCov(Greedy):
    """D-optimality and unseen space."""

    decides_by = "the volume of the map's uncertainty, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_logdet_cov",)


@POLICIES.register("popgs_cov_trace")
class CovTrace(Greedy):
    """Trace of the covariance."""

    decides_by = "the sum of the map's variances"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_cov_trace",)
    brings = SELECTED_VIEWS


@POLICIES.register("popgs_cov_trace_cov")
class CovTraceCov(Greedy):
    """Trace of the covariance and unseen space."""

    decides_by = "the sum of the map's variances, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_cov_trace_cov",)


@POLICIES.register("popgs_info_trace")
class InfoTrace(Greedy):
    """Trace of the information."""

    decides_by = "the sum of the map's information"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_info_trace",)
    brings = SELECTED_VIEWS


@POLICIES.register("popgs_info_trace_cov")
class InfoTraceCov(Greedy):
    """Trace of the information and unseen space."""

    decides_by = "the sum of the map's information, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_info_trace_cov",)


@POLICIES.register("popgs_min_eig")
class MinEig(Greedy):
    """E-optimality."""

    decides_by = "the worst known parameter of the map"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_min_eig",)
    brings = SELECTED_VIEWS


@POLICIES.register("popgs_min_eig_cov")
class MinEigCov(Greedy):
    """E-optimality and unseen space."""

    decides_by = "the worst known parameter of the map, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_min_eig_cov",)


@POLICIES.register("popgs_logdet_block")
class LogDetBlock(Greedy):
    """D-optimality by blocks."""

    decides_by = "the volume of the map's uncertainty, by blocks"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_logdet_block",)
    brings = SELECTED_VIEWS


@POLICIES.register("popgs_logdet_block_cov")
class LogDetBlockCov(Greedy):
    """D-optimality by blocks and unseen space."""

    decides_by = "the volume of the map's uncertainty, by blocks, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_logdet_block_cov",)


@POLICIES.register("popgs_cov_trace_block")
class CovTraceBlock(Greedy):
    """Trace of the covariance by blocks."""

    decides_by = "the sum of the map's variances, by blocks"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_cov_trace_block",)
    brings = SELECTED_VIEWS


@POLICIES.register("popgs_cov_trace_block_cov")
class CovTraceBlockCov(Greedy):
    """Trace of the covariance by blocks, and unseen space."""

    decides_by = "the sum of the map's variances, by blocks, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_gains = ("popgs_cov_trace_block_cov",)
