"""Next Best Sense as a policy ([next_best_sense])."""

from __future__ import annotations

from dataclasses import replace

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS


@POLICIES.register("next_best_sense")
class NextBestSense(Greedy):
    """argmax .1 I_colour + I_depth and nothing else: the published selector of views."""

    criterion = "information of a view, above all of its depth, over that of all keyframes"
    source = "Strong et al., Next Best Sense, ICRA 2025"
    required_features = ("next_best_sense",)
    native_settings = replace(SELECTED_VIEWS, budget="10 views by an arm, each the best of 10 poses around an object")


@POLICIES.register("next_best_sense_cov")
class NextBestSenseCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = .1 I_colour + I_depth; no travel term, like its selector."""

    criterion = "information of a view, above all of its depth, and unseen space"
    source = "this project, with the gain of Strong et al., Next Best Sense, ICRA 2025"
    required_features = ("next_best_sense_cov",)
