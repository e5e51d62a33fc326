"""The network's inputs from observations, scaled by physical ranges.

No running statistics: those of a set-valued entry would be per row, which breaks equivariance and is spoilt by empty
rows (stable-baselines3's VecNormalize does so). Places and directions are told in the camera's heading frame (at the
camera, x along its horizontal viewing direction, z up), so a turned or moved world looks the same.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from activestructure_gym.envs.observation import candidate_columns, plane_columns

Tensors = Mapping[str, Tensor]

_REACH = 5.0  # metres that count as 1: the farthest a plane may be to be seen
_MAX_DISTANCE = 4.0  # in units of the reach; larger distances count as this one
_TRAVEL_FRAMES = 5.0  # of the travel discount 1 / (1 + frames / 5) that all policies share
_MIN_GAIN = 1e-3  # features below a thousandth of an image count linearly, larger ones by their logarithm

_XYZ, _LOOK = candidate_columns("x", "y", "z"), candidate_columns("look_x", "look_y", "look_z")
_PATH, _FRAMES, _REVISIT = (candidate_columns(name) for name in ("path_length", "frames", "revisit"))

# Columns of the plane table that lie in 0..1 already.
_UNIT_COLUMNS = (
    "quality_coverage", "quality_density", "quality_fit", "quality_observations", "quality_boundary",
    "quality_normals", "quality_stability", "quality_interior", "quality", "surprise_connectivity",
    "surprise_neighbourhood", "surprise_geometric", "surprise", "deficit", "structural", "betweenness",
)  # fmt: skip

PLANE_INPUTS = 3 + 3 + 1 + 4 + len(_UNIT_COLUMNS)
CANDIDATE_INPUTS = 3 + 3 + 4 + 3  # and INPUTS_PER_FEATURE for every gain
# Of the candidates' inputs: height above the camera and revisit. In the preset `fast` both are always 0, so weights
# drawn for them would never be learnt and would only add noise in the presets where they vary.
CONSTANT_IF_FAST = (2, 9)
INPUTS_PER_FEATURE = 3
GLOBAL_INPUTS = 3  # and one for every gain


def heading(pose: Tensor) -> tuple[Tensor, Tensor]:  # [B, 7] -> [B, 3] position, [B, 2] (cos, sin) of the yaw
    """Position and yaw direction of the camera; (0, 0) where it looks straight up or down."""
    w, x, y, z = pose[:, 3:].unbind(-1)
    forward = torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x)], -1)  # of the optical axis, horizontal part
    return pose[:, :3], forward / (forward.norm(dim=-1, keepdim=True) + 1e-6)


def turned(vectors: Tensor, yaw: Tensor) -> Tensor:  # [B, N, 3], [B, 2] -> [B, N, 3]
    """World vectors in the heading frame."""
    cosine, sine = yaw[:, None, 0], yaw[:, None, 1]
    x, y, z = vectors.unbind(-1)
    return torch.stack([cosine * x + sine * y, cosine * y - sine * x, z], -1)


def near(offsets: Tensor) -> Tensor:
    """Metres in units of the reach, cut off far away."""
    return (offsets / _REACH).clamp(-_MAX_DISTANCE, _MAX_DISTANCE)


def plane_inputs(observation: Tensors) -> Tensor:  # [B, P, PLANE_INPUTS]
    """Every plane as the camera has it before it; 0 in rows without a plane."""
    table, present = observation["plane_features"], observation["plane_mask"]
    position, yaw = heading(observation["pose"])
    normals = table[..., plane_columns("normal_x", "normal_y", "normal_z")]
    centroids = table[..., plane_columns("centroid_x", "centroid_y", "centroid_z")]
    (offset,) = plane_columns("offset")
    distance = (normals * position[:, None]).sum(-1, keepdim=True) + table[..., offset, None]
    counts = table[..., plane_columns("area", "points", "observations", "degree")].log1p()
    counts = counts / torch.tensor([4.0, 10.0, 4.0, 3.0], device=table.device)
    inputs = torch.cat(
        [
            turned(normals, yaw),
            near(turned(centroids - position[:, None], yaw)),
            near(distance),
            counts,
            table[..., plane_columns(*_UNIT_COLUMNS)],
        ],
        dim=-1,
    )
    return inputs * present[..., None]


def candidate_inputs(observation: Tensors) -> Tensor:  # [B, K, CANDIDATE_INPUTS + INPUTS_PER_FEATURE G]
    """Every candidate: where it is, what it costs, what it would see, and its features; 0 in rows without one.

    A gain g comes three times: its size as log(1 + g / 0.001) / 7, and as shares of the largest valid one without and
    with the travel discount, so that the greedy planners are simple functions of the inputs.
    """
    table, valid = observation["candidates"], observation["action_mask"][..., None]
    position, yaw = heading(observation["pose"])
    frames = table[..., _FRAMES]
    discount = 1.0 / (1.0 + frames / _TRAVEL_FRAMES)
    seen = observation["candidate_planes"]
    deficit, area = observation["plane_features"][..., plane_columns("deficit", "area")].unbind(-1)
    lacking = torch.stack([torch.ones_like(deficit), deficit, deficit * area], dim=-1)  # [B, P, 3]
    features = observation["candidate_features"]
    inputs = torch.cat(
        [
            near(turned(table[..., _XYZ] - position[:, None], yaw)),
            turned(table[..., _LOOK], yaw),
            near(table[..., _PATH]),
            frames.log1p() / 4,
            discount,
            table[..., _REVISIT],
            (seen @ lacking).log1p() / 3,
            feature_sizes(features),
            _shares(features, valid),
            _shares(features * discount, valid),
        ],
        dim=-1,
    )
    return inputs * valid


def feature_sizes(features: Tensor) -> Tensor:
    """About 1 for a gain of 1, 0 for none; the sign is kept."""
    return features.sign() * (features.abs() / _MIN_GAIN).log1p() / 7


def _shares(features: Tensor, valid: Tensor) -> Tensor:  # [B, K, G], [B, K, 1] -> [B, K, G] in -1..1
    largest = (features.abs() * valid).amax(dim=1, keepdim=True)
    return features / largest.clamp(min=1e-12) * (largest > 0)


def global_inputs(observation: Tensors) -> Tensor:  # [B, GLOBAL_INPUTS + G]
    """Remaining budget, log counts of candidates and planes, and the largest valid value of every feature."""
    valid = observation["action_mask"]
    counts = [valid.sum(-1, keepdim=True).log1p() / 6, observation["plane_mask"].sum(-1, keepdim=True).log1p() / 4]
    most = (feature_sizes(observation["candidate_features"]) * valid[..., None]).amax(dim=1)
    return torch.cat([observation["budget"], *counts, most], dim=-1)


def plane_links(observation: Tensors) -> Tensor:  # [B, P, P]
    """Row-normalised adjacency with self-loops: exp(-w_ij) where there is an edge (Eq. 4: small = reliable)."""
    weights, present = observation["plane_edges"], observation["plane_mask"]
    links = (-weights).exp() * (weights > 0) + torch.eye(weights.shape[-1], device=weights.device)
    links = links * present[:, None, :]
    return links / links.sum(-1, keepdim=True).clamp(min=1e-12)
