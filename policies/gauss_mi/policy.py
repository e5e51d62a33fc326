"""Define the policies of GauSS-MI ([gauss_mi]): score views by the reliability of the Gaussians from their side."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("gauss_mi")
class GaussMI(Greedy):
    """Choose argmax sum w_i c_dir (-log r_dir), the published view selection, without a travel term.

    r_dir is the probability that Gaussian i is correct from the side of the view, see the feature `gauss_mi`.
    """

    criterion = "unreliability of the Gaussians from the view's side"
    travel_term = "revisits discounted"
    source = "Xie et al., GauSS-MI, 2025"
    required_features = ("gauss_mi",)
    # An image is taken where a path ends, and mapping goes on during the flight. The camera has 640 x 480 pixels and
    # 106 x 90 degrees; here it has half as many along each side.
    native_settings = replace(
        SELECTED_VIEWS,
        stages=(("moves",),),
        candidates=94,
        budget="640 x 480 at 106 x 90 degrees, 20 iterations a keyframe and more during the flight",
        changes={
            **SELECTED_VIEWS.changes,
            "sensor.width": 320,
            "sensor.height": 240,
            "sensor.horizontal_fov_deg": 106.26,
        },
    )


@POLICIES.register("gauss_mi_cov")
class GaussMICov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum w_i c_dir (-log r_dir) is the feature `gauss_mi`.

    G_cov is `hole_area`, and lambda_o the share of observed space around the agent (`adaptive`). The feature includes
    GauSS-MI's own discount of revisited poses. There is no travel term.
    """

    criterion = "unreliability of the Gaussians from the view's side, and unseen space"
    travel_term = "revisits discounted"
    source = "this project, with the gain of Xie et al., GauSS-MI, 2025"
    required_features = ("gauss_mi_cov",)
