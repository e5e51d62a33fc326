"""Compute the structural surprise of planes and the structural information deficit (Sec. 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.planes.vectors import distances
from activestructure_gym.ranges import check_ranges

_EPSILON = 1e-9

_RANGES = {
    "floor": "[0, 1]",
    "saturation_degree": "[1, 1000000]",
    "radius": "(0, 100000]",
    "max_angle_deg": "(0, 90]",
}


@dataclass(frozen=True)
class SurpriseConfig:
    """Configure Eqs. 8 to 10. The paper names the symbols; the values are this project's."""

    floor: float = 0.1  # phi_min, smallest value of each of the three indicators
    saturation_degree: int = 3  # degree in the spanning forest at which the connectivity surprise is smallest
    radius: float = 1.5  # Eq. 8: r, metres between the centroids of nearby planes
    max_angle_deg: float = 45.0  # Eq. 9: theta_max, degrees; no acute angle is farther from both 0 and 90

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


@dataclass(frozen=True)
class Surprise:
    """Hold the three indicators of surprise and their product, each [N] in [0, 1]."""

    connectivity: np.ndarray  # phi^c
    neighbourhood: np.ndarray  # phi^r
    geometric: np.ndarray  # phi^g
    total: np.ndarray  # Phi


def connectivity_surprise(degree: np.ndarray, config: SurpriseConfig) -> np.ndarray:
    """Return phi^c [N]. It decreases with the degree [N] in the spanning forest: planes with few edges lack context."""
    return np.maximum(config.floor, 1.0 - degree / config.saturation_degree)


def neighbourhood_surprise(
    centroids: np.ndarray,  # [N, 3]
    edges: np.ndarray,  # [N, N] bool
    config: SurpriseConfig,
) -> np.ndarray:  # [N]
    """Return phi^r, which increases with the fraction of nearby planes without an edge to this plane (Eq. 8).

    The paper prints it as phi^c, a misprint. Without a plane within the radius it is the floor.
    """
    near = distances(centroids) < config.radius
    np.fill_diagonal(near, False)
    count = near.sum(axis=1)
    linked = (near & edges).sum(axis=1)
    missing = np.where(count > 0, 1.0 - linked / (count + _EPSILON), 0.0)
    return np.clip(config.floor + (1.0 - config.floor) * missing, 0.0, 1.0)  # Eq. 8


def geometric_surprise(
    normals: np.ndarray,  # [N, 3] unit
    tree: np.ndarray,  # [N, N] bool
    config: SurpriseConfig,
) -> np.ndarray:  # [N]
    """Return phi^g: how far the angles of a plane to its neighbours are from 0 and 90 degrees (Eq. 9).

    Neighbours are in the spanning forest. Their mean deviation in units of ``config.max_angle_deg``, each at most 1, is
    mapped linearly to the range from ``config.floor`` to 1. Without neighbours it is the floor.
    """
    angle = np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T), 0.0, 1.0)))
    # theta is acute by definition, so the 180 degrees of the paper's canonical angles are never the nearest.
    deviation = np.minimum(np.minimum(angle, 90.0 - angle) / config.max_angle_deg, 1.0)
    degree = tree.sum(axis=1)
    mean = (deviation * tree).sum(axis=1) / np.maximum(degree, 1)
    return config.floor + (1.0 - config.floor) * mean  # Eq. 9


def structural_surprise(
    normals: np.ndarray, centroids: np.ndarray, edges: np.ndarray, tree: np.ndarray, config: SurpriseConfig
) -> Surprise:
    """Return the three indicators of each of N planes and their product, which is large only if all three are large.

    Arguments as in `neighbourhood_surprise` and `geometric_surprise`.
    """
    c = connectivity_surprise(tree.sum(axis=1), config)
    r = neighbourhood_surprise(centroids, edges, config)
    g = geometric_surprise(normals, tree, config)
    return Surprise(connectivity=c, neighbourhood=r, geometric=g, total=c * r * g)


def information_deficit(quality: np.ndarray, surprise: np.ndarray) -> np.ndarray:
    """Return the deficit gamma = (1 - q) Phi (Eq. 10) of planes with quality q [N] and surprise Phi [N].

    It is large for planes that are incompletely reconstructed and poorly integrated.
    """
    return (1.0 - quality) * surprise
