"""FisherRF as a policy ([fisherrf])."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS, NativeSettings


@POLICIES.register("fisherrf")
class FisherRF(Greedy):
    """argmax sum H_c / (H_train + lambda) and nothing else: the published selector."""

    criterion = "information of a view over that of all keyframes"
    source = "Jiang et al., FisherRF, ECCV 2024"
    required_features = ("fisherrf",)
    native_settings = NativeSettings(budget=SELECTED_VIEWS.budget)


@POLICIES.register("fisherrf_cov")
class FisherRFCov(Greedy):
    """argmax G_cov + lambda_o G_Q with G_Q = sum H_c / (H_train + lambda); no travel term, like its selector.

    The feature `fisherrf`, formula and source there. Alone it is blind to what the map lacks, hence G_cov, `hole_area`.
    """

    criterion = "information of a view over that of all keyframes, and unseen space"
    source = "this project, with the gain of Jiang et al., FisherRF, ECCV 2024"
    required_features = ("fisherrf_cov",)


@POLICIES.register("fisherrf_path")
class FisherRFPath(Greedy):
    """argmax of the information on the way and at its end: the closed loop of the published active mapping.

    The feature `fisherrf_path`, formula and source there: the 20 most informative views by themselves, then their ways.
    """

    criterion = "information of a view and, each look counted as known to the next, of the way there"
    travel_term = "the gain of the path"
    source = "Jiang et al., FisherRF, ECCV 2024: its active mapping"
    required_features = ("fisherrf_path",)
    native_settings = NativeSettings(
        mapper="splatam",
        iterations=60,
        stages=(("frontier_facing?rows=192", "unsure_facing?apart_m=1&rows=64", "around?radius_m=1&rows=64"),),
        candidates=320,
        budget="2000 steps of 5 cm and 5 degrees, 800 x 800, 60 iterations",
    )
