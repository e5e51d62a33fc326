"""Augment data by reflection: views have the same values in an observation and in its mirror image."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from activestructure_gym.envs.observation import candidate_columns, plane_columns


def mirrored(observation: Mapping[str, Tensor], which: Tensor) -> dict[str, Tensor]:
    """Reflect the states selected by ``which`` [B] bool in the plane y = 0 of the world; return all B states.

    The image's x axis is reflected too, so that the camera keeps a proper rotation: S R diag(-1, 1, 1) with
    S = diag(1, -1, 1), whose quaternion is (z, y, x, w) of R's (w, x, y, z). In the camera's heading frame every y
    changes its sign. Features, costs and visibility do not change.
    """
    result, flip = dict(observation), which[:, None]
    pose = observation["pose"]
    reflected = torch.cat([pose[:, :3] * pose.new_tensor([1.0, -1.0, 1.0]), pose[:, 3:].flip(-1)], dim=-1)
    result["pose"] = torch.where(flip, reflected, pose)
    columns = {
        "candidates": candidate_columns("y", "look_y"),
        "plane_features": plane_columns("normal_y", "centroid_y"),
    }
    for key, chosen in columns.items():
        signs = torch.ones_like(observation[key][0, 0])
        signs[chosen] = -1.0
        result[key] = torch.where(flip[..., None], observation[key] * signs, observation[key])
    return result
