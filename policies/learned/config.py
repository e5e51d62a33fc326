"""Define the network's configuration, stored next to the weights. This module does not load torch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from activestructure_gym.errors import InputError, listed, short_repr

# Entries of the observation that the network reads. The others can be removed before training.
USED_KEYS = (
    "pose",
    "budget",
    "candidates",
    "candidate_features",
    "action_mask",
    "plane_features",
    "plane_mask",
    "plane_edges",
    "candidate_planes",
)

# Entries of the observation that describe the Plane Scene Graph.
PLANE_KEYS = ("plane_features", "plane_mask", "plane_edges", "candidate_planes")

# Minimum and maximum of every size, so that a checkpoint from an unknown source cannot exhaust the memory.
LIMITS = {"planes": (1, 1024), "candidates": (1, 1024), "rounds": (0, 16), "max_planes": (1, 4096)}
MAX_FEATURES = 64


@dataclass(frozen=True)
class NetworkConfig:
    """Define the sizes of the candidate-set network, which accepts any number of candidates and planes."""

    features: tuple[str, ...] = ("pixel", "hole_area")  # columns of ``candidate_features``, in this order
    planes: int = 32  # number of channels per plane
    candidates: int = 48  # number of channels per candidate
    rounds: int = 2  # number of rounds of message passing between neighbouring planes
    use_planes: bool = True  # False: the network gets an empty Plane Scene Graph, for an ablation
    max_planes: int = 64  # largest number of planes that the network reads, as in training; the largest are kept

    def __post_init__(self) -> None:
        features = self.features
        if not isinstance(features, tuple | list) or not all(isinstance(name, str) for name in features):
            raise InputError(f"a learned policy needs a list of features by name, got {short_repr(features)}")
        if not 1 <= len(features) <= MAX_FEATURES:
            raise InputError(f"a learned policy needs 1 to {MAX_FEATURES} features, got {len(features)}")
        object.__setattr__(self, "features", tuple(features))
        for name, (least, most) in LIMITS.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise InputError(
                    f"{name} of the network must be a whole number from {least} to {most}, got {short_repr(value)}"
                )
        if not isinstance(self.use_planes, bool):
            raise InputError(f"use_planes of the network must be true or false, got {short_repr(self.use_planes)}")

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, as values that JSON can store."""
        return {**dataclasses.asdict(self), "features": list(self.features)}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> NetworkConfig:
        """Return the configuration from the result of `as_dict`; raise `InputError` for other content."""
        known = {field.name for field in dataclasses.fields(cls)}
        # The shipped checkpoint has neither ``use_planes`` nor ``max_planes``.
        if not isinstance(content, Mapping) or set(content) | {"use_planes", "max_planes"} != known:
            raise InputError(f"a network is described by {listed(sorted(known))}, got {short_repr(content)}")
        return cls(**content)
