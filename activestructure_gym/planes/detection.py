"""Detect planes in a depth image: fit blocks of pixels, grow regions, refine pixels, merge coplanar segments.

The method follows PEAC ([peac]) and CAPE ([cape]): fit a plane to every small block of the image, join coplanar blocks,
then assign every pixel to a plane. Only depth is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from activestructure_gym.geometry import transform_points
from activestructure_gym.geometry.depth_noise import axial_sigma
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes import detection_kernels as kernels
from activestructure_gym.planes import segment_kernels
from activestructure_gym.ranges import check_ranges
from activestructure_gym.sensors.noise import DepthNoise

_RANGES = {
    "depth_noise_scale": "[0, 1000]",
    "max_depth": "(0, 1000]",
    **dict.fromkeys(("max_incidence_deg", "link_angle_deg", "window_tilt_deg", "merge_angle_deg",
                     "merge_wide_angle_deg"), "[0, 90]"),
    "block_columns": "[1, 8192]",
    "min_block": "[2, 8192]",
    **dict.fromkeys(("block_sigma", "link_sigma", "window_sigma", "segment_sigma", "pixel_sigma", "explained_sigma",
                     "merge_sigma", "merge_back", "merge_wide_sigma"), "[0, 1e6]"),
    **dict.fromkeys(("block_tolerance", "link_tolerance", "window_tolerance", "segment_tolerance", "pixel_tolerance",
                     "explained_tolerance", "merge_tolerance", "merge_wide_tolerance", "merge_reach"), "[0, 1000]"),
    "block_valid_share": "(0, 1]",
    **dict.fromkeys(("window_share", "explained_share"), "[0, 1]"),
    "min_pixel_share": "[0, 1)",
    "max_points": "[1, 100000]",
}  # fmt: skip


@dataclass(frozen=True)
class PlaneDetectionConfig:
    """Configure plane detection. Fields with "sigma" are multiples of the sensor's axial noise at the pixel's depth."""

    # Factor on the axial noise of a Kinect, 1.2 mm + 1.9 mm (z - 0.4 m)^2. The default is for noise-free depth, as in
    # the default sensor and the paper; for other sensors see `depth_noise_scale`. Smaller values split noisy walls,
    # larger values merge walls with objects close to them.
    depth_noise_scale: float = 0.25
    max_depth: float = 6.0  # metres; beyond this depth a Kinect-type sensor cannot separate a plane from its neighbour
    max_incidence_deg: float = 80.0  # largest angle between ray and normal; beyond it, normal and extent are uncertain
    block_columns: int = 54  # number of blocks across the image; divided by sqrt(depth_noise_scale) for scales above 1
    min_block: int = 3  # side of the smallest block, pixels
    block_sigma: float = 1.6  # a block is planar if its rms distance is below block_sigma * sigma + block_tolerance
    block_tolerance: float = 0.002  # metres
    block_valid_share: float = 0.9  # fraction of the block's pixels that must have a return
    link_angle_deg: float = 12.0  # largest angle between the normals of two blocks that join
    link_sigma: float = 2.4  # largest distance between a block's centroid and the plane of the other
    link_tolerance: float = 0.004  # metres, added to link_sigma * sigma
    # Degrees. If noise tilts the plane of a block by more than this (standard deviation), its normal is fitted to the 3
    # x 3 blocks around it, if enough of their pixels are valid and coplanar.
    window_tilt_deg: float = 2.5
    window_share: float = 0.5  # fraction of the pixels of the 3 x 3 blocks that must be valid
    # The 3 x 3 blocks are coplanar if their rms distance is below window_sigma * sigma + window_tolerance.
    window_sigma: float = 1.4
    window_tolerance: float = 0.001  # metres
    min_pixel_share: float = 0.005  # smallest segment, as a fraction of the image's pixels
    # A segment is rejected if its rms distance exceeds segment_sigma * sigma + segment_tolerance.
    segment_sigma: float = 2.0
    segment_tolerance: float = 0.006  # metres
    pixel_sigma: float = 3.0  # a pixel joins a plane if its distance is below pixel_sigma * sigma + pixel_tolerance
    pixel_tolerance: float = 0.004  # metres
    # A segment is noise if planes of larger segments explain more than this fraction of its pixels.
    explained_share: float = 0.6
    # A plane explains a pixel if its distance is below explained_sigma * sigma + explained_tolerance.
    explained_sigma: float = 2.0
    explained_tolerance: float = 0.002  # metres
    merge_angle_deg: float = 4.0  # largest angle between two segments of one image that are merged as coplanar
    merge_sigma: float = 1.0  # largest distance between the smaller segment's centroid and the larger one's plane
    merge_tolerance: float = 0.005  # metres, added to merge_sigma * sigma
    # Factor on this limit for the distance of the larger segment's centroid to the smaller one's plane, whose tilt acts
    # over a long distance.
    merge_back: float = 3.0
    # Noise tilts narrow segments more. Up to this angle in degrees, two segments are merged if the rms distance of
    # their points is small.
    merge_wide_angle_deg: float = 15.0
    # Largest rms distance between the smaller segment's points and the larger one's plane.
    merge_wide_sigma: float = 1.5
    merge_wide_tolerance: float = 0.002  # metres, added to merge_wide_sigma * sigma
    merge_reach: float = 4.0  # metres, largest distance between the centroids (the graph's relaxed threshold)
    max_points: int = 256  # largest number of points kept per segment

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


def depth_noise_scale(depth_noise: DepthNoise, multiplier: float = 1.0) -> float:
    """Return ``PlaneDetectionConfig.depth_noise_scale`` for a sensor's noise model and its multiplier.

    ``depth_noise`` is `none`, `kinect` or `redwood`. The minimum is 0.25, also for noise-free depth: smaller values
    bring no improvement, since real surfaces are not flat.
    """
    return max(0.25, multiplier) if depth_noise != "none" else 0.25


@dataclass(frozen=True)
class PlaneSegment:
    """Hold a planar segment of one image in world coordinates. Its plane is ``normal . x + offset = 0`` in metres."""

    normal: np.ndarray  # [3] unit, world, towards the camera
    offset: float  # metres
    centroid: np.ndarray  # [3] metres, world
    area: float  # m^2, sum of the areas that its pixels cover on the plane
    rms: float  # rms distance of its pixels to the plane, metres
    pixels: int  # number of pixels
    points: np.ndarray  # [M, 3] metres, world: an even selection of its pixels, in row-major order
    label: int  # value of its pixels in the label image


@dataclass(frozen=True)
class PlaneDetection:
    """Hold the planar segments of one frame and the label image of their pixels."""

    segments: tuple[PlaneSegment, ...]  # largest number of pixels first; segments[k].label == k
    labels: np.ndarray  # [H, W] int32 segment of each pixel, -1 = none


def no_planes(frame: Frame) -> PlaneDetection:
    """Return the detection of a frame without planar segments."""
    return PlaneDetection((), np.full(frame.depth.shape, -1, np.int32))


def detect_planes(frame: Frame, config: PlaneDetectionConfig | None = None) -> list[PlaneSegment]:
    """Return the planar segments of a frame, largest number of pixels first; [] if there are none."""
    return list(segment_planes(frame, config).segments)


def segment_planes(frame: Frame, config: PlaneDetectionConfig | None = None) -> PlaneDetection:
    """Return the planar segments of a frame together with the label image."""
    config = config or PlaneDetectionConfig()
    depth = np.ascontiguousarray(frame.depth, dtype=np.float32)
    camera = frame.camera
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    nothing = no_planes(frame)

    # Noise tilts the plane of a small block, so a noisier sensor needs larger blocks.
    columns = config.block_columns / max(config.depth_noise_scale, 1.0) ** 0.5
    size = max(config.min_block, int(camera.width / columns + 0.5))
    if min(depth.shape) < size:
        return nothing
    block_labels, planes = _block_regions(depth, lens, size, config)
    if not len(planes):
        return nothing
    labels, planes = _refine(depth, lens, size, block_labels, planes, config)
    moments = segment_kernels.segment_moments(depth, lens, labels, len(planes))
    moments, new_label = _merge_coplanar(moments, config)
    moments, order = _keep_large(moments, config.min_pixel_share * depth.size)
    if not len(moments):
        return nothing
    segment_kernels.rename(labels, order[new_label])
    return PlaneDetection(_lift(frame, depth, lens, labels, moments, config), labels)


def _noise(z: np.ndarray, scale: float) -> np.ndarray:
    return scale * axial_sigma(z)


def _block_regions(
    depth: np.ndarray, lens: np.ndarray, size: int, config: PlaneDetectionConfig
) -> tuple[np.ndarray, np.ndarray]:  # block labels [By, Bx], planes [S, 5]: normal, d, rms
    scale = config.depth_noise_scale
    moments = kernels.block_moments(depth, lens, size, config.max_depth)
    shape = moments.shape[:2]
    flat = moments.reshape(-1, kernels.MOMENTS)
    planes, mean = kernels.fit_planes(flat)
    accepted, unsure, tilt = kernels.planar_blocks(
        flat, planes, mean, size, lens[0], scale,
        (max(3.0, config.block_valid_share * size * size), config.block_sigma, config.block_tolerance,
         cosine_deg(config.max_incidence_deg), np.radians(config.window_tilt_deg)),
    )  # fmt: skip
    if unsure.any():
        _steady(moments, planes, mean, tilt, accepted, unsure, size * size, config)
    # Regions start from the flattest block first, and from blocks with an uncertain normal last.
    able = np.flatnonzero(accepted)
    order = able[np.lexsort((planes[able, 4], unsure[able]))]
    labels = np.full(shape, -1, np.int32)
    regions = np.zeros_like(flat)
    count = kernels.grow_regions(
        kernels.Blocks(
            moments, planes.reshape(*shape, 5), accepted.reshape(shape), config.link_sigma * tilt.reshape(shape)
        ),
        order, scale, np.radians(config.link_angle_deg), config.link_sigma, config.link_tolerance,
        labels, regions,
    )  # fmt: skip
    if not count:
        return labels, np.zeros((0, 5))
    regions = regions[:count]
    planes, mean = kernels.fit_planes(regions)
    # Blocks do not cover the border of a plane, and the refinement adds its pixels. So half of the minimum size is
    # enough here.
    keep = regions[:, 0] >= 0.5 * config.min_pixel_share * depth.size
    keep &= planes[:, 4] < config.segment_sigma * _noise(mean[:, 2], scale) + config.segment_tolerance
    # Merge the segments of a plane that an object separates, before each one is tested alone.
    merged, new_label = _merge_coplanar(regions[keep], config)
    table = np.full(len(regions) + 1, -1, np.int32)
    table[np.flatnonzero(keep)] = new_label
    return table[labels], kernels.fit_planes(merged)[0]


def _steady(
    moments: np.ndarray,  # [By, Bx, 10] moments of the blocks
    planes: np.ndarray,  # [B, 5] planes of the blocks, changed in place
    mean: np.ndarray,  # [B, 3] centroids of the blocks
    tilt: np.ndarray,  # [B] radians, standard deviation of the normals, changed in place
    accepted: np.ndarray,  # [B] bool, planar blocks
    unsure: np.ndarray,  # [B] bool, blocks with an uncertain normal, changed in place
    block_pixels: int,  # number of pixels of a full block
    config: PlaneDetectionConfig,
) -> None:
    """Replace the uncertain normals of blocks by the normal of the surrounding 3 x 3 blocks, if these are coplanar.

    At large distances the noise of a block is as large as its width, and its plane is arbitrary (36 degrees off at 5
    m). Larger blocks everywhere would lose narrow planes.
    """
    shape = moments.shape[:2]
    padded = np.pad(np.where(accepted.reshape(*shape, 1), moments, 0.0), ((1, 1), (1, 1), (0, 0)))
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    window = (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]).reshape(-1, kernels.MOMENTS)
    at = np.flatnonzero(unsure & (window[:, 0] >= config.window_share * 9.0 * block_pixels))
    fitted, centre = kernels.fit_planes(window[at])
    limit = config.window_sigma * _noise(centre[:, 2], config.depth_noise_scale) + config.window_tolerance
    flat = fitted[:, 4] < limit
    at, fitted = at[flat], fitted[flat]
    planes[at, :3] = fitted[:, :3]
    planes[at, 3] = -np.einsum("ij,ij->i", fitted[:, :3], mean[at])  # through the centroid of the block itself
    planes[at, 4] = fitted[:, 4]
    tilt[at] /= 9.0  # the 3 x 3 blocks are three times as wide and have nine times as many pixels
    unsure[at] = False


def _refine(
    depth: np.ndarray,  # [H, W] float32 metres, 0 = no return
    lens: np.ndarray,  # [4] fx, fy, cx, cy in pixels
    size: int,
    block_labels: np.ndarray,
    planes: np.ndarray,
    config: PlaneDetectionConfig,
) -> tuple[np.ndarray, np.ndarray]:  # labels [H, W], planes [T, 5]: normal, d, rms
    """Assign pixels to planes, remove planes that larger planes explain, and assign the pixels of these again.

    ``block_labels`` [By, Bx] is the plane of each block of ``size`` pixels, and ``planes`` [S, 5] the planes. Noise
    sometimes splits a tilted segment off a wall, and blocks across a distant edge look like a chamfer.
    """
    scale = config.depth_noise_scale
    edge_on = cosine_deg(config.max_incidence_deg)
    pixel = (scale, config.pixel_sigma, config.pixel_tolerance, config.max_depth, edge_on)
    labels = kernels.refine_pixels(depth, lens, kernels.Choice(size, block_labels, planes), *pixel)
    shares = segment_kernels.explained_shares(
        depth, lens, labels, planes, scale, config.explained_sigma, config.explained_tolerance
    )
    keep = shares <= config.explained_share
    if keep.all():
        return labels, planes
    table = np.append(np.where(keep, np.cumsum(keep) - 1, -1), -1).astype(np.int32)
    left = kernels.Choice(size, table[block_labels], planes[keep])
    return kernels.refine_pixels(depth, lens, left, *pixel), left.planes


def _merge_coplanar(
    moments: np.ndarray,  # [S, 10]
    config: PlaneDetectionConfig,
) -> tuple[np.ndarray, np.ndarray]:  # moments [T, 10], new label of each old segment [S]
    """Merge coplanar segments, the closest pair first, with a new fit after every merge."""
    limits = (
        config.merge_sigma, config.merge_tolerance, config.merge_back, cosine_deg(config.merge_angle_deg),
        config.merge_wide_sigma, config.merge_wide_tolerance, cosine_deg(config.merge_wide_angle_deg),
        config.merge_reach,
    )  # fmt: skip
    moments = moments.copy()
    alive, label = segment_kernels.merge_coplanar(moments, config.depth_noise_scale, limits)
    table = np.cumsum(alive) - 1
    return moments[alive], np.where(alive[label], table[label], -1)


@cache
def cosine_deg(degrees: float) -> float:
    """Return the cosine of an angle in degrees. The result is cached, since thresholds are used often."""
    return float(np.cos(np.radians(degrees)))


def _keep_large(moments: np.ndarray, min_pixels: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the moments of segments with at least ``min_pixels`` pixels, largest first, and a table of labels.

    The table gives the new label for each old one, or -1. Its last entry is -1.
    """
    keep = np.flatnonzero(moments[:, 0] >= max(min_pixels, 3))
    keep = keep[np.argsort(-moments[keep, 0], kind="stable")]
    table = np.full(len(moments) + 1, -1)
    table[keep] = np.arange(len(keep))
    return moments[keep], table


def _lift(
    frame: Frame,
    depth: np.ndarray,
    lens: np.ndarray,
    labels: np.ndarray,
    moments: np.ndarray,
    config: PlaneDetectionConfig,
) -> tuple[PlaneSegment, ...]:
    planes, mean = kernels.fit_planes(moments)
    # Below 3 degrees between ray and plane, the area that a pixel covers is not reliable.
    areas = segment_kernels.segment_areas(depth, lens, labels, planes, np.sin(np.radians(3.0)))
    rotation = frame.world_from_camera[:3, :3]
    normals = planes[:, :3] @ rotation.T
    centroids = transform_points(frame.world_from_camera, mean)
    offsets = -np.einsum("ij,ij->i", normals, centroids)
    # Step between the pixels kept of each segment, and end of its points in the flat array.
    pixels = moments[:, 0].astype(np.int64)
    steps = -(-pixels // config.max_points)
    ends = np.cumsum(-(-pixels // np.maximum(steps, 1)))
    points = segment_kernels.spread_points(depth, lens, labels, steps, ends)
    points = transform_points(frame.world_from_camera, points)
    segments = []
    for k, end in enumerate(ends):
        segments.append(
            PlaneSegment(
                normal=normals[k],
                offset=float(offsets[k]),
                centroid=centroids[k],
                area=float(areas[k]),
                rms=float(planes[k, 4]),
                pixels=int(pixels[k]),
                points=points[ends[k - 1] if k else 0 : end],
                label=k,
            )
        )
    return tuple(segments)
