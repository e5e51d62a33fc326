"""Compute with single vectors and points [3], faster than numpy, whose cost per call is high."""

from __future__ import annotations

import math

import numpy as np


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the distance of two points [3], in a quarter of the time of `numpy.linalg.norm`."""
    return length(a - b)


def length(a: np.ndarray) -> float:
    """Return the Euclidean length of a vector [3]."""
    return math.sqrt(a.dot(a))


def distances(points: np.ndarray) -> np.ndarray:  # [N, 3] -> [N, N]
    """Return the distance of every pair of points, in half of the time of `numpy.linalg.norm`."""
    between = points[:, None] - points
    between *= between
    return np.sqrt(np.add.reduce(between, axis=2))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product of two vectors [3]. `numpy.cross` takes 30 times as long for one pair."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
