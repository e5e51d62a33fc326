"""Model the axial noise of a structured-light depth camera, for the simulated sensor and for plane detection."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

Depth = TypeVar("Depth", float, np.ndarray)

MIN_SIGMA_M = 0.0012  # metres: standard deviation at depth MIN_DEPTH_M
GROWTH = 0.0019  # metres of standard deviation per square metre of depth beyond MIN_DEPTH_M
MIN_DEPTH_M = 0.4  # metres


def axial_sigma(depth: Depth) -> Depth:
    """Return the standard deviation in metres of the depth that a Kinect v1 measures on a surface it views head-on.

    It is 0.0012 + 0.0019 (z - 0.4)^2 for depth z in metres, the part of the noise model of [nguyen2012] that does not
    depend on the incidence angle. Kernels compile this function with `kernel`.
    """
    return MIN_SIGMA_M + GROWTH * (depth - MIN_DEPTH_M) ** 2
