"""Where the camera really was: the pose of a frame, found by aligning it with what the map shows.

The sensor's reported pose is the start. Each step renders the map from the pose so far and moves the camera by the
Gauss-Newton step of two residuals per pixel, with camera_from_world <- Exp(xi) camera_from_world, xi = (rho, phi):

    depth   n . (q - p)      q the measured point, p and n the map's point and normal at the same pixel (point to plane)
    colour  I - C            brightness, three channels, through the mean slope of both images

A point moves by rho + phi x p, so that the rows of the linear system are [n, p x n] and, with g the slope of the
brightness per metre, -[g, p x g]. The depth alone fixes the three or five degrees of freedom that a room's planes
determine; the colour fixes the others.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TrackingConfig:
    """Constants of `track_pose`."""

    iterations: int = 0  # Gauss-Newton steps, each with a rendering; 0 = believe the reported pose
    covered_alpha: float = 0.99  # pixels where the map is at least this opaque take part (SplaTAM)
    reach: float = 0.15  # metres, depth differences above are another surface
    depth_sigma: float = 0.005  # metres, least scale of the depth residual
    color_sigma: float = 0.05  # of the 0..1 range, least scale of the colour residual
    huber: float = 1.345  # residuals beyond this many sigmas count linearly (95 % efficiency on Gaussian noise)
    prior_m: float = 0.02  # metres, how far the reported position is believed to be off per axis
    prior_deg: float = 1.0  # degrees, as above for the rotation
    converged_m: float = 1e-4  # metres; a step shorter than this (and a rotation of as much at 1 m) ends the search
    least_share: float = 0.05  # of the pixels; with fewer to compare the reported pose stands
