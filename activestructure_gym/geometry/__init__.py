"""Provide rigid transforms, the pinhole camera and unit directions on the sphere.

Conventions of the whole project:

- World frame: right-handed, z up, metres.
- Camera frame: OpenCV axes (x right, y down, z forward).
- ``world_from_camera``: 4x4 transform from camera to world points.
- Pixel (column u, row v): its centre is (u + 0.5, v + 0.5).
- Depth: metres along the optical axis; 0 = not measured, or no surface within range.
- Quaternions: order w, x, y, z (written wxyz).
"""

from activestructure_gym.geometry.camera import PinholeCamera
from activestructure_gym.geometry.directions import fibonacci_directions
from activestructure_gym.geometry.rigid import (
    invert_rigid,
    look_along,
    rotation_angle,
    se3_exp,
    transform_points,
    unrounded,
)

__all__ = [
    "PinholeCamera",
    "fibonacci_directions",
    "invert_rigid",
    "look_along",
    "rotation_angle",
    "se3_exp",
    "transform_points",
    "unrounded",
]
