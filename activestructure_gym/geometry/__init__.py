"""Rigid motions, the pinhole camera and directions on the sphere.

Conventions, once for the whole project: the world is right-handed, z up, metres; cameras have OpenCV axes (x right,
y down, z forward); ``world_from_camera`` is the 4x4 that maps camera points to world points; the centre of pixel
(column u, row v) is (u + 0.5, v + 0.5); depth is metres along the optical axis, 0 = no return; quaternions are wxyz.
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
