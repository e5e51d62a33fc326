"""Define the policies of FisherRF ([fisherrf]): score views by Fisher information."""

from __future__ import annotations

from activestructure_gym.policies.base import POLICIES
from activestructure_gym.policies.greedy import Greedy
from activestructure_gym.policies.native_settings import SELECTED_VIEWS, SQUARE_CAMERA, NativeSettings


@POLICIES.register("fisherrf")
class FisherRF(Greedy):
    """Choose argmax sum H_c / (H_train + lambda), the published view selection ([fisherrf]), without a travel term.

    H_c and H_train are the diagonals of the Fisher information of the candidate and of all keyframes.
    """

    criterion = "Fisher information of a view relative to that of all keyframes"
    source = "Jiang et al., FisherRF, ECCV 2024"
    required_features = ("fisherrf",)
    native_settings = SELECTED_VIEWS


@POLICIES.register("fisherrf_cov")
class FisherRFCov(Greedy):
    """Choose argmax G_cov + lambda_o G_Q, where G_Q = sum H_c / (H_train + lambda) is the feature `fisherrf`.

    G_Q cannot score regions that the map does not cover yet, hence G_cov, the feature `hole_area`. lambda_o is the
    share of observed space around the agent (`adaptive`). There is no travel term.
    """

    criterion = "Fisher information of a view relative to that of all keyframes, and unseen space"
    source = "this project, with the gain of Jiang et al., FisherRF, ECCV 2024"
    required_features = ("fisherrf_cov",)


@POLICIES.register("fisherrf_path")
class FisherRFPath(Greedy):
    """Choose argmax of the Fisher information along the path and at its end (feature `fisherrf_path`).

    This is the rule of FisherRF's published active mapping. The 20 views with the most information of their own are
    selected first, and then scored with the information along their paths.
    """

    criterion = "Fisher information of a view and of the path to it, each part counted once"
    travel_term = "the gain of the path"
    source = "Jiang et al., FisherRF, ECCV 2024: its active mapping"
    required_features = ("fisherrf_path",)
    # Every 4th frame is a keyframe with 24 iterations (60 every 10 frames) on keyframes that overlap with it. Seeds are
    # balls that can become ellipsoids, and only those below 0.0001 opacity are pruned. Candidates are scored at half of
    # the image size, since seeds are as wide as a pixel of the image: at a quarter, aliasing raises the information
    # about known surface 5 to 30 times.
    native_settings = NativeSettings(
        mapper="splatam",
        keyframe_every=4,
        iterations=24,
        stages=(("frontier_facing?nearest_m=0.5&farthest_m=1&rows=256", "floor?yaws=8&rows=64"),),
        candidates=320,
        changes=SQUARE_CAMERA
        | {
            "views.heights_m": (0.0,),
            "views.scoring_scale": 0.5,
            "mapper.isotropic": False,
            "mapper.seed_thickness": 1.0,
            "mapper.border_sigmas": None,
            "mapper.in_front_factor": 10.0,
            "mapper.global_psnr": 0.0,
            "mapper.global_new_share": 1.0,
            "mapper.prune_opacity": 1e-4,
            "mapper.prune_scale": 1e9,
            "mapper.prune_steps": (0,),
            "mapper.mean_rate": 1e-3,
            "mapper.log_scale_rate": 1e-2,
        },
        budget="2000 steps of 5 cm and 5 degrees, 800 x 800, 60 iterations",
    )
