"""Define the result of ray casting, and the interface of the two tracers that compute it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np


class Hits(NamedTuple):
    """Hold the first intersection of each ray."""

    distance: np.ndarray  # [N] float32, in units of the direction's length; inf for a miss
    face: np.ndarray  # [N] int32, -1 for a miss
    u: np.ndarray  # [N] float32 barycentric: hit = (1 - u - v) A + u B + v C
    v: np.ndarray  # [N] float32


class Tracer(Protocol):
    """Intersect rays with one mesh; several threads may call it at once. Rays are float32 [N, 3], contiguous."""

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the first hit of each ray at a distance of at least 0; both sides of a triangle count."""
        ...

    def blocked(self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> np.ndarray:  # [N] bool
        """Return whether a ray hits at a distance from 0 to ``reach`` [N] float32."""
        ...
