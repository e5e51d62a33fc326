"""Hold the candidate pool of a world that can capture given poses only, such as a recording."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import rotation_angle
from activestructure_gym.views.candidates import CandidatePool, ViewConfig

_SAME_M, _SAME_RAD = 0.01, np.radians(1.0)  # views this close to a captured one, by both measures, add nothing


class GivenViews(CandidatePool):
    """Hold given poses that can still be offered; they replace the lattice of `CandidatePool`.

    A view is removed once it is captured, since recordings are dense: `ViewConfig.visited_distance_m` is not used. No
    clearance is required besides that of the path, since the recording camera was at these poses.
    """

    def __init__(self, world_from_camera: np.ndarray, config: ViewConfig, seed: int) -> None:
        """Create the pool of the poses [M, 4, 4], which have no roll. ``seed`` controls the random subsets."""
        self.config = config
        self._seed, self._clearance_m = seed, 0.0
        self.world_from_camera = world_from_camera
        self.positions = world_from_camera[:, :3, 3]
        self._open = np.ones((len(world_from_camera), 1), dtype=bool)

    def mark_visited(self, world_from_camera: np.ndarray) -> None:
        """Remove the view at a camera pose [4, 4], and those within 1 cm and 1 degree of it."""
        metres, radians = self._apart(world_from_camera)
        self._open[(metres <= _SAME_M) & (radians <= _SAME_RAD)] = False

    def at(self, world_from_camera: np.ndarray, *, metres: float, degrees: float) -> np.ndarray | None:  # [4, 4]
        """Return the view nearest to a pose [4, 4], visited or not; None if none is within both limits.

        The distance is the larger of position and rotation, each as a share of its limit.
        """
        far, turned = self._apart(world_from_camera)
        apart = np.maximum(far / metres, turned / np.radians(degrees))
        nearest = int(np.argmin(apart))
        return self.world_from_camera[nearest] if apart[nearest] <= 1.0 else None

    def _apart(self, world_from_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance in metres [M] and the angle in radians [M] of every view to a pose [4, 4]."""
        metres = np.linalg.norm(self.positions - world_from_camera[:3, 3], axis=1)
        return metres, rotation_angle(self.world_from_camera, world_from_camera)

    def _rotations_of(self, position: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return self.world_from_camera[position, :3, :3]


def without_overlap(
    centres: np.ndarray,  # [M, 3] metres
    radii: np.ndarray,  # [M] metres
    slack: float,  # metres
) -> list[int]:
    """Return the indices of spheres that contain all others, each up to ``slack``; the first of equal ones is kept."""
    kept: list[int] = []
    for index, (centre, radius) in enumerate(zip(centres, radii)):
        apart = np.linalg.norm(centres[kept] - centre, axis=1)
        if not (apart + radius <= radii[kept] + slack).any():
            kept.append(index)
    return kept
