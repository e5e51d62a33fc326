"""Augment training data by reflection: a candidate has the same score in an observation and in its mirror image."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from activestructure_gym.envs.observation import candidate_columns, plane_columns


def mirrored(observation: Mapping[str, Tensor], which: Tensor) -> dict[str, Tensor]:
    """Reflect the states with ``which`` [B] true in the world's plane y = 0, and return all B states.

    The image's x axis is reflected too, so the camera keeps a proper rotation: R becomes S R diag(-1, 1, 1) with
    S = diag(1, -1, 1), and its quaternion (w, x, y, z) becomes (z, y, x, w). In the camera's heading frame, every y
    coordinate changes its sign. Features, costs and visibility do not change.
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
