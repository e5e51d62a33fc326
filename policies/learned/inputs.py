"""Compute the network's inputs from observations, scaled by physical ranges.

Shapes: B observations, K candidates, P planes, G feature columns. Inputs are not normalised by running statistics, as
stable-baselines3's VecNormalize does. Such statistics would differ from row to row, which breaks equivariance, and
empty rows would distort them.

Positions and directions are in the camera's heading frame: origin at the camera, x along its horizontal view direction,
z up. The inputs therefore do not change if the world is rotated about z or shifted.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from activestructure_gym.envs.observation import candidate_columns, plane_columns

Tensors = Mapping[str, Tensor]

_REACH = 5.0  # metres, unit of lengths; planes farther away are not visible
_MAX_DISTANCE = 4.0  # maximum of lengths, in units of `_REACH`
_TRAVEL_FRAMES = 5.0  # frames at which the shared travel discount 1 / (1 + frames / 5) is 0.5
_MIN_GAIN = 1e-3  # features below this value enter about linearly, larger ones by their logarithm

_XYZ, _LOOK = candidate_columns("x", "y", "z"), candidate_columns("look_x", "look_y", "look_z")
_PATH, _FRAMES, _REVISIT = (candidate_columns(name) for name in ("path_length", "frames", "revisit"))

# Columns of the plane table with values in 0..1.
_UNIT_COLUMNS = (
    "quality_coverage", "quality_density", "quality_fit", "quality_observations", "quality_boundary",
    "quality_normals", "quality_stability", "quality_interior", "quality", "surprise_connectivity",
    "surprise_neighbourhood", "surprise_geometric", "surprise", "deficit", "structural", "betweenness",
)  # fmt: skip

PLANE_INPUTS = 3 + 3 + 1 + 4 + len(_UNIT_COLUMNS)
CANDIDATE_INPUTS = 3 + 3 + 4 + 3  # inputs per candidate, plus INPUTS_PER_FEATURE for each feature column
# Indices of two candidate inputs, height above the camera and revisit. In the preset `fast` both are always 0. Random
# initial weights for them would not be trained there, and would add noise in presets where the inputs vary.
CONSTANT_IF_FAST = (2, 9)
INPUTS_PER_FEATURE = 3
GLOBAL_INPUTS = 3  # inputs of the whole state, plus one for each feature column


def heading(pose: Tensor) -> tuple[Tensor, Tensor]:  # [B, 7] -> [B, 3] position, [B, 2] (cos, sin) of the yaw
    """Return the position (metres) and the yaw direction of the camera; (0, 0) for a vertical view direction.

    ``pose`` is position and quaternion (w, x, y, z), world from camera.
    """
    w, x, y, z = pose[:, 3:].unbind(-1)
    forward = torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x)], -1)  # horizontal part of the optical axis
    return pose[:, :3], forward / (forward.norm(dim=-1, keepdim=True) + 1e-6)


def turned(vectors: Tensor, yaw: Tensor) -> Tensor:  # [B, N, 3], [B, 2] -> [B, N, 3]
    """Rotate world vectors about z into the heading frame; ``yaw`` is (cos, sin) of the camera's yaw."""
    cosine, sine = yaw[:, None, 0], yaw[:, None, 1]
    x, y, z = vectors.unbind(-1)
    return torch.stack([cosine * x + sine * y, cosine * y - sine * x, z], -1)


def near(offsets: Tensor) -> Tensor:
    """Convert metres to units of 5 m, limited to -4..4."""
    return (offsets / _REACH).clamp(-_MAX_DISTANCE, _MAX_DISTANCE)


def plane_inputs(observation: Tensors) -> Tensor:  # [B, P, PLANE_INPUTS]
    """Return the inputs of every plane: geometry in the camera's heading frame, and features; 0 in padded rows."""
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
    """Return pose, travel cost, visible planes and features of every candidate; 0 in padded rows.

    A feature g has three inputs: log(1 + g / 0.001) / 7; g divided by the largest g of the valid candidates; and the
    same with g times the travel discount. Greedy planners are simple functions of these inputs.
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
    """Return sign(g) log(1 + |g| / 0.001) / 7 of every feature value g; it is about 1 for g = 1."""
    return features.sign() * (features.abs() / _MIN_GAIN).log1p() / 7


def _shares(features: Tensor, valid: Tensor) -> Tensor:  # [B, K, G], [B, K, 1] -> [B, K, G] in -1..1
    """Return each feature divided by its largest magnitude among the valid candidates; 0 if that is 0."""
    largest = (features.abs() * valid).amax(dim=1, keepdim=True)
    return features / largest.clamp(min=1e-12) * (largest > 0)


def global_inputs(observation: Tensors) -> Tensor:  # [B, GLOBAL_INPUTS + G]
    """Return the inputs of the whole state.

    They are the remaining budget, the logarithms of the numbers of candidates and planes, and the largest value of each
    feature among the valid candidates.
    """
    valid = observation["action_mask"]
    counts = [valid.sum(-1, keepdim=True).log1p() / 6, observation["plane_mask"].sum(-1, keepdim=True).log1p() / 4]
    most = (feature_sizes(observation["candidate_features"]) * valid[..., None]).amax(dim=1)
    return torch.cat([observation["budget"], *counts, most], dim=-1)


def plane_links(observation: Tensors) -> Tensor:  # [B, P, P]
    """Return the weights of messages between planes: exp(-w_ij) for each edge and 1 on the diagonal, row-normalised.

    w_ij is the edge weight of Eq. 4, which is small for a reliable edge. Padded planes send nothing.
    """
    weights, present = observation["plane_edges"], observation["plane_mask"]
    links = (-weights).exp() * (weights > 0) + torch.eye(weights.shape[-1], device=weights.device)
    links = links * present[:, None, :]
    return links / links.sum(-1, keepdim=True).clamp(min=1e-12)
