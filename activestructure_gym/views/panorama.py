"""Measure unmapped regions around a position in panoramas rendered from the map.

An open pixel is a pixel with low opacity: the map has no surface there. Clusters of open pixels are measured by their
solid angle and by a volume. This is ActiveSplat's measure of a Voronoi node ([activesplat, code]) at half its image
resolution. ActiveSplat's thresholds in pixels hold for one pixel per degree, so they are given in degrees here.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import convolve, distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from activestructure_gym.geometry import PinholeCamera, look_along

DEG_PER_PIXEL = 2.0  # degrees per pixel of a panorama
SIDES = 3  # number of pinhole images that are joined to one panorama
# Horizontal and vertical field of view of each image, degrees; elevations beyond 75 degrees are not seen.
SIDE_DEG = (120.0, 150.0)
OPEN = 0.8  # a pixel is open if 1 - opacity exceeds this
NEIGHBOUR_DEG = 5.0  # neighbourhood radius of DBSCAN (eps), degrees
MIN_DEG2 = 25.0  # minimum neighbourhood of a DBSCAN core pixel, square degrees
DILATION_DEG = 15.0  # diameter of the ellipse that dilates a cluster to include the surrounding surface, degrees


@dataclass(frozen=True)
class Opening:
    """Hold the measures of one cluster of open pixels."""

    missing: float  # sum of 1 - opacity over the cluster, square degrees
    volume: float  # volume of the convex hull of the surrounding surface in (azimuth, elevation, depth), rad^2 m


def camera() -> PinholeCamera:
    """Return the camera of one image of a panorama. fx and fy differ to give both axes the same degrees per pixel."""
    width, height = (round(side / DEG_PER_PIXEL) for side in SIDE_DEG)
    focal = 0.5 * np.array([width, height]) / np.tan(0.5 * np.radians(SIDE_DEG))
    return PinholeCamera(width, height, float(focal[0]), float(focal[1]), width / 2.0, height / 2.0)


def poses(positions: np.ndarray) -> np.ndarray:  # [N, 3] metres -> [N * SIDES, 4, 4] world_from_camera
    """Return the poses of three level cameras at each of N positions, in clockwise order of azimuth."""
    azimuth = -np.arange(SIDES) * np.radians(SIDE_DEG[0])
    looks = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(SIDES)], axis=1)
    return np.stack([look_along(p, look) for p in positions for look in looks]).reshape(-1, 4, 4)


def side_by_side(images: np.ndarray) -> np.ndarray:  # [N * SIDES, h, w] -> [N, h, SIDES * w]
    """Join the ``SIDES`` images rendered from the poses of each position to one panorama per position."""
    count, height, width = images.shape
    return images.reshape(count // SIDES, SIDES, height, width).transpose(0, 2, 1, 3).reshape(-1, height, SIDES * width)


def clusters(
    mask: np.ndarray,  # [H, W] bool
    radius: float,  # pixels
    least: int,  # minimum number of mask pixels within the radius of a core pixel, including itself
) -> np.ndarray:  # [H, W] int64 labels: 0 outside all clusters, from 1 inside
    """Cluster the pixels of a mask with DBSCAN. A border pixel gets the label of its nearest core pixel."""
    reach = int(radius)
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disk = dy**2 + dx**2 <= radius**2
    core = mask & (convolve(mask.astype(np.int64), disk.astype(np.int64), mode="constant") >= least)
    labels = np.zeros(mask.shape, dtype=np.int64)
    if not core.any():
        return labels
    number = np.full(mask.shape, -1)
    number[core] = np.arange(core.sum())
    padded = np.pad(number, reach, constant_values=-1)
    pairs = []
    for down, right in np.argwhere(disk) - reach:
        if (down, right) > (0, 0):
            other = padded[reach + down :, reach + right :][: mask.shape[0], : mask.shape[1]]
            both = (number >= 0) & (other >= 0)
            pairs.append(np.stack([number[both], other[both]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_matrix((np.ones(len(first), dtype=bool), (first, second)), shape=(core.sum(), core.sum()))
    labels[core] = 1 + connected_components(graph, directed=False)[1]
    away, nearest = distance_transform_edt(~core, return_indices=True)
    return np.where(mask & (away <= radius), labels[tuple(nearest)], 0)


def openings(alpha: np.ndarray, depth: np.ndarray) -> list[Opening]:  # panoramas [H, W] in 0..1, [H, W] metres
    """Return the measures of all clusters of open pixels in a panorama.

    ``alpha`` is the rendered opacity; ``depth`` is the median depth, and 0 where alpha stays below one half.
    """
    missing = 1.0 - alpha.astype(np.float64)
    pixel = DEG_PER_PIXEL**2
    labels = clusters(missing > OPEN, NEIGHBOUR_DEG / DEG_PER_PIXEL, round(MIN_DEG2 / pixel))
    return [
        Opening(float(missing[labels == label].sum()) * pixel, hull_volume(labels == label, depth))
        for label in range(1, int(labels.max()) + 1)
    ]


def hull_volume(mask: np.ndarray, depth: np.ndarray) -> float:  # [H, W] bool, [H, W] metres -> rad^2 m
    """Return the volume of the convex hull of the surface around a cluster of open pixels.

    The surface points are the corners of the largest outline of the dilated ``mask``, with coordinates azimuth and
    elevation (radians) and depth (metres). Straight parts of the outline have only their ends, as in the original. The
    volume is 0 if fewer than four of them have a rendered depth, or if all are coplanar.
    """
    width = 2 * int(0.5 * DILATION_DEG / DEG_PER_PIXEL) + 1
    ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    dilated = cv2.dilate(mask.astype(np.uint8), ellipse)
    outlines, _ = cv2.findContours(dilated, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    columns, rows = max(outlines, key=cv2.contourArea).reshape(-1, 2).T
    known = depth[rows, columns] > 0
    points = np.column_stack([np.radians(DEG_PER_PIXEL) * np.stack([columns, rows], axis=1), depth[rows, columns]])
    points = points[known].astype(np.float64)
    if len(points) < 4:
        return 0.0
    try:
        return float(ConvexHull(points).volume)
    except QhullError:  # coplanar points
        return 0.0
