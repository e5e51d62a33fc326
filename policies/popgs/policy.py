"""Define the policies of POp-GS ([popgs]), one for each criterion of optimal design, without a travel term.

H is the Fisher information of all keyframes about the map, and h is its diagonal. B is the information of a candidate,
and d is its diagonal. The unit is the median of H. The features of the same names compute:

- ``popgs_logdet``: sum of log(1 + d / (h + lambda)) (D);
- ``popgs_cov_trace``: sum of 1 / (h + lambda) - 1 / (h + lambda + d) (A in textbooks, T in the paper);
- ``popgs_info_trace``: sum of d (T in textbooks, A in the paper), a negative control;
- ``popgs_min_eig``: growth of the smallest entry of the whole map (E), a negative control;
- ``popgs_logdet_block``, ``popgs_cov_trace_block``: the same of H + lambda + B, with one 6 x 6 block per Gaussian.

The policy ``NAME`` maximises this gain G_Q; ``NAME_cov`` includes unseen space and maximises G_cov + lambda_o G_Q.
"""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES, Observation, without_revisits
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("popgs_logdet")
class LogDet(Greedy):
    """Choose argmax sum log(1 + d / h): D-optimality.

    h is the information of the keyframes about a parameter plus lambda, d that of the candidate.
    """

    criterion = "the volume of the map's uncertainty"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_logdet_cov")
class LogDetCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum log(1 + d / h): D-optimality and unseen space.

    G_cov is `hole_area`, h and d are those of `LogDet`, and lambda_o is the share of observed space near the agent.
    """

    criterion = "the volume of the map's uncertainty, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet_cov",)


@POLICIES.register("popgs_cov_trace")
class CovTrace(Greedy):
    """Choose argmax sum 1 / h - 1 / (h + d): reduction of the trace of the covariance.

    h is the information of the keyframes about a parameter plus lambda, d that of the candidate.
    """

    criterion = "the sum of the map's variances"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_cov_trace_cov")
class CovTraceCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum 1 / h - 1 / (h + d): covariance and unseen space.

    G_cov is `hole_area`, h and d are those of `CovTrace`, and lambda_o is the share of observed space near the agent.
    """

    criterion = "the sum of the map's variances, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace_cov",)


class _OfNewViews(Greedy):
    """Choose among the views that are no revisits, if there are any."""

    def act(self, observation: Observation) -> int:
        """Return the valid row with the highest gain that is no revisit, if there is one."""
        return super().act(without_revisits(observation))


@POLICIES.register("popgs_info_trace")
class InfoTrace(_OfNewViews):
    """Choose argmax sum d: trace of the candidate's information, independent of the keyframes.

    Revisits are not candidates: their gain does not fall, so that one view would be chosen again and again.
    """

    criterion = "the sum of the map's information"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_info_trace",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_info_trace_cov")
class InfoTraceCov(_OfNewViews):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum d: trace of the information and unseen space.

    G_cov is `hole_area`, d is the information of the candidate about a parameter, and lambda_o is the share of observed
    space near the agent. Revisits are not candidates, as for `InfoTrace`.
    """

    criterion = "the sum of the map's information, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_info_trace_cov",)


@POLICIES.register("popgs_min_eig")
class MinEig(Greedy):
    """Choose argmax min (h + d) - min h, both over the whole map: E-optimality.

    h is the information of the keyframes about a parameter plus lambda, d that of the candidate.
    """

    criterion = "the least known parameter of the map"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_min_eig",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_min_eig_cov")
class MinEigCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q ranks min (h + d) - min h: E-optimality and unseen space.

    G_cov is `hole_area` divided by its maximum over the candidates. G_Q is the rank of the gain among them, in 0..1.
    Both minima are over the whole map: h is the information of the keyframes about a parameter plus lambda, and d that
    of the candidate. lambda_o is the share of observed space near the agent.
    """

    criterion = "the least known parameter of the map, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_min_eig_cov",)


@POLICIES.register("popgs_logdet_block")
class LogDetBlock(Greedy):
    """Choose argmax sum log det(H + B) - log det H: D-optimality with one 6 x 6 block per Gaussian.

    H is the information of the keyframes plus lambda, B that of the candidate.
    """

    criterion = "the volume of the map's uncertainty, by blocks"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet_block",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_logdet_block_cov")
class LogDetBlockCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum log det(H + B) - log det H, with unseen space.

    G_cov is `hole_area`, H and B are those of `LogDetBlock`, and lambda_o is the share of observed space near the
    agent.
    """

    criterion = "the volume of the map's uncertainty, by blocks, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_logdet_block_cov",)


@POLICIES.register("popgs_cov_trace_block")
class CovTraceBlock(Greedy):
    """Choose argmax sum tr H^-1 - tr (H + B)^-1: reduction of the trace of the covariance, with 6 x 6 blocks.

    H is the information of the keyframes plus lambda, B that of the candidate.
    """

    criterion = "the sum of the map's variances, by blocks"
    source = "Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace_block",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("popgs_cov_trace_block_cov")
class CovTraceBlockCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum tr H^-1 - tr (H + B)^-1, with unseen space.

    G_cov is `hole_area`, H and B are those of `CovTraceBlock`, and lambda_o is the share of observed space near the
    agent.
    """

    criterion = "the sum of the map's variances, by blocks, and unseen space"
    source = "this project, with the gain of Wilson et al., POp-GS, CVPR 2025"
    required_features = ("popgs_cov_trace_block_cov",)
