"""What decides the shape of the network; kept beside the weights. No torch in here."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from activestructure_gym.errors import InputError

# The entries of the observation that the network reads; all others can be dropped before training.
USED_KEYS = (
    "pose",
    "budget",
    "candidates",
    "candidate_gains",
    "action_mask",
    "plane_features",
    "plane_mask",
    "plane_edges",
    "candidate_planes",
)


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the candidate-set network. The numbers of candidates and planes are free: it is a function of sets."""

    gains: tuple[str, ...] = ("pixel", "hole_area")  # columns of ``candidate_gains``, in this order
    planes: int = 32  # channels of a plane
    candidates: int = 48  # channels of a candidate
    rounds: int = 2  # of passing messages between neighbouring planes

    def __post_init__(self) -> None:
        object.__setattr__(self, "gains", tuple(self.gains))
        if not self.gains or not all(isinstance(name, str) for name in self.gains):
            raise InputError(f"a learned policy needs at least one gain by name, got {self.gains!r}")
        for name in ("planes", "candidates", "rounds"):
            value, least = getattr(self, name), 0 if name == "rounds" else 1
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"{name} of the network must be a whole number of at least {least}, got {value!r}")

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {**dataclasses.asdict(self), "gains": list(self.gains)}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> NetworkConfig:
        """The configuration that `as_dict` described; raises `InputError` for anything else."""
        known = {field.name for field in dataclasses.fields(cls)}
        if not isinstance(content, Mapping) or set(content) != known:
            raise InputError(f"a network is described by {', '.join(sorted(known))}, got {content!r}")
        return cls(**content)
