"""GauSS-MI as a policy ([gauss_mi])."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy


@POLICIES.register("gauss_mi")
class GaussMI(Greedy):
    """argmax sum w_i c_dir (-log r_dir) and nothing else: the published selector."""

    criterion = "how unreliable Gaussians are from a view's side"
    travel_term = "revisits discounted"
    source = "Xie et al., GauSS-MI, 2025"
    required_features = ("gauss_mi",)


@POLICIES.register("gauss_mi_cov")
class GaussMICov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum w_i c_dir (-log r_dir); no travel term.

    The feature `gauss_mi`, formula and source there; it holds the planner's own discount of revisited poses.
    """

    criterion = "how unreliable Gaussians are from a view's side, and unseen space"
    travel_term = "revisits discounted"
    source = "this project, with the gain of Xie et al., GauSS-MI, 2025"
    required_features = ("gauss_mi_cov",)
