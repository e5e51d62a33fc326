"""Model the axial noise of a structured-light depth camera; used by the sensor and by plane detection."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Depth = TypeVar("Depth", float, np.ndarray)

MIN_SIGMA_M = 0.0012  # metres
GROWTH = 0.0019  # metres per square metre
MIN_DEPTH_M = 0.4  # metres


def axial_sigma(depth: Depth) -> Depth:
    """Return the standard deviation of a Kinect v1's depth in metres, seen head-on: 0.0012 + 0.0019 (z - 0.4)^2.

    This is the part of the error that is independent of the incidence angle ([nguyen2012]). Kernels call the version
    compiled by `kernel`.
    """
    return MIN_SIGMA_M + GROWTH * (depth - MIN_DEPTH_M) ** 2
