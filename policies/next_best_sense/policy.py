"""Define the policies of Next Best Sense ([next_best_sense]): score views by Fisher information of colour and depth."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("next_best_sense")
class NextBestSense(Greedy):
    """Choose argmax sum H_c / (H_train + lambda), H = 0.1 H_colour + H_depth per Gaussian, without a travel term.

    H_colour and H_depth are the Fisher information of colours and depth, of the candidate and of all keyframes.
    """

    criterion = "Fisher information of a view, mainly of its depth, relative to that of all keyframes"
    source = "Strong et al., Next Best Sense, ICRA 2025"
    required_features = ("next_best_sense",)
    native_settings = replace(SELECTED_VIEWS, budget="10 views by an arm, each the best of 10 poses around an object")


@POLICIES.register("next_best_sense_cov")
class NextBestSenseCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q is the feature `next_best_sense`, without a travel term.

    G_cov is `hole_area`, and lambda_o the share of observed space around the agent (`adaptive`).
    """

    criterion = "Fisher information of a view, mainly of its depth, and unseen space"
    source = "this project, with the gain of Strong et al., Next Best Sense, ICRA 2025"
    required_features = ("next_best_sense_cov",)
