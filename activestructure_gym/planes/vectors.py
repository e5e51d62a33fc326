"""Single vectors and points [3]: what numpy does too, without its cost per call."""

from __future__ import annotations

import math

import numpy as np


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two points [3]; `numpy.linalg.norm` gives the same digits in four times as long."""
    return length(a - b)


def length(a: np.ndarray) -> float:
    """Length of a vector [3]."""
    return math.sqrt(a.dot(a))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of two vectors [3]; numpy's own takes 30 times as long for one pair."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
