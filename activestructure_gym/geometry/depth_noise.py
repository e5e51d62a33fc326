"""Axial noise of a structured-light depth camera: added by the sensor, assumed by plane detection."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Depth = TypeVar("Depth", float, np.ndarray)

MIN_SIGMA_M = 0.0012  # metres
GROWTH = 0.0019  # metres per square metre
MIN_DEPTH_M = 0.4  # metres


def axial_sigma(depth: Depth) -> Depth:
    """Standard deviation of a Kinect v1's depth in metres, seen head-on: 0.0012 + 0.0019 (z - 0.4)^2.

    The part of the error that does not depend on the angle ([nguyen2012]). Kernels call what
    `kernel` makes of it.
    """
    return MIN_SIGMA_M + GROWTH * (depth - MIN_DEPTH_M) ** 2
