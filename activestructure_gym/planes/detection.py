"""Planes in one depth image: block fits, region growing, pixel refinement, coplanar merge.

The family is PEAC ([peac]) and CAPE ([cape]): fit a plane to every small block of
the image, join blocks that lie on one plane, then let every pixel choose. Only depth is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from activestructure_gym.geometry import transform_points
from activestructure_gym.geometry.depth_noise import axial_sigma
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes import detection_kernels as kernels
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
    """Thresholds. Those with "sigma" are multiples of the sensor's axial noise at the depth in question."""

    # Times the Kinect model 1.2 mm + 1.9 mm (z - 0.4 m)^2. The default suits noise-free depth, as the default sensor
    # and the paper have it; for other sensors see `depth_noise_scale`. Too small breaks noisy walls into pieces, too
    # large blurs what stands close in front of them.
    depth_noise_scale: float = 0.25
    max_depth: float = 6.0  # metres; beyond it a Kinect-type sensor cannot tell a plane from its neighbour
    max_incidence_deg: float = 80.0  # between ray and normal; closer to edge-on neither normal nor extent is known
    block_columns: int = 54  # blocks across the image; above noise scale 1 divided by sqrt(depth_noise_scale)
    min_block: int = 3  # pixels, edge of the smallest block
    block_sigma: float = 1.6  # a block is planar below block_sigma * sigma + block_tolerance
    block_tolerance: float = 0.002  # metres
    block_valid_share: float = 0.9  # of the block's pixels must have a return
    link_angle_deg: float = 12.0  # between the normals of blocks that join
    link_sigma: float = 2.4  # of distance between a block's centroid and the other's plane
    link_tolerance: float = 0.004  # metres
    # Where noise tilts a block's plane by more (standard deviation, degrees), the 3 x 3 blocks around it give its
    # plane, provided that enough of their pixels are there and lie on one.
    window_tilt_deg: float = 2.5
    window_share: float = 0.5  # of their pixels that must be there
    window_sigma: float = 1.4  # they lie on one plane below window_sigma * sigma + window_tolerance
    window_tolerance: float = 0.001  # metres
    min_pixel_share: float = 0.005  # of the image; smaller segments are dropped
    segment_sigma: float = 2.0  # a segment is rejected above segment_sigma * sigma + segment_tolerance rms
    segment_tolerance: float = 0.006  # metres
    pixel_sigma: float = 3.0  # a pixel joins below pixel_sigma * sigma + pixel_tolerance
    pixel_tolerance: float = 0.004  # metres
    explained_share: float = 0.6  # of a segment's pixels that larger planes explain: above it the segment is noise
    explained_sigma: float = 2.0  # a pixel is explained below explained_sigma * sigma + explained_tolerance
    explained_tolerance: float = 0.002  # metres
    merge_angle_deg: float = 4.0  # coplanar segments of one image become one
    merge_sigma: float = 1.0  # of the smaller one's centroid to the larger one's plane
    merge_tolerance: float = 0.005  # metres
    merge_back: float = 3.0  # times as much from the larger one's centroid: a small piece's tilt acts on a long lever
    # Noise tilts a slat by more than that; up to this angle its points must be near, by their root mean square.
    merge_wide_angle_deg: float = 15.0
    merge_wide_sigma: float = 1.5  # of their rms distance to the larger one's plane
    merge_wide_tolerance: float = 0.002  # metres
    merge_reach: float = 4.0  # metres between the centroids (the graph's relaxed threshold)
    max_points: int = 256  # kept per segment

    def __post_init__(self) -> None:
        check_ranges(self, _RANGES)


def depth_noise_scale(depth_noise: DepthNoise, multiplier: float = 1.0) -> float:
    """The scale that suits a sensor's noise model (`none`, `kinect`, `redwood`) and its multiplier.

    Noise-free depth is not trusted to the last digit either: below 0.25 nothing gets better, and real surfaces bulge.
    """
    return max(0.25, multiplier) if depth_noise != "none" else 0.25


@dataclass(frozen=True)
class PlaneSegment:
    """A planar piece of one image, in the world. Every point x on it has ``normal . x + offset = 0``."""

    normal: np.ndarray  # [3] unit, world, towards the camera
    offset: float  # metres
    centroid: np.ndarray  # [3] world
    area: float  # m^2, sum of the pixels' footprints on the plane
    rms: float  # metres, of the pixels to the plane
    pixels: int
    points: np.ndarray  # [M, 3] world, evenly subsampled in row order
    label: int  # its value in the label image


@dataclass(frozen=True)
class PlaneDetection:
    """The planes of one frame, with their pixels."""

    segments: tuple[PlaneSegment, ...]  # largest first; segments[k].label == k
    labels: np.ndarray  # [H, W] int32, -1 = no plane


def detect_planes(frame: Frame, config: PlaneDetectionConfig | None = None) -> list[PlaneSegment]:
    """The planar segments of a frame, largest (in pixels) first; empty when there are none."""
    return list(segment_planes(frame, config).segments)


def segment_planes(frame: Frame, config: PlaneDetectionConfig | None = None) -> PlaneDetection:
    """The planar segments of a frame together with the label image."""
    config = config or PlaneDetectionConfig()
    depth = np.ascontiguousarray(frame.depth, dtype=np.float32)
    camera = frame.camera
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    nothing = PlaneDetection((), np.full(depth.shape, -1, np.int32))

    # Noise tilts a small block's plane: a much noisier sensor needs larger ones.
    columns = config.block_columns / max(config.depth_noise_scale, 1.0) ** 0.5
    size = max(config.min_block, int(camera.width / columns + 0.5))
    if min(depth.shape) < size:
        return nothing
    block_labels, planes = _block_regions(depth, lens, size, config)
    if not len(planes):
        return nothing
    labels, planes = _refine(depth, lens, size, block_labels, planes, config)
    moments = kernels.segment_moments(depth, lens, labels, len(planes))
    moments, new_label = _merge_coplanar(moments, config)
    moments, order = _keep_large(moments, config.min_pixel_share * depth.size)
    if not len(moments):
        return nothing
    # -1 stays -1: the last entry of the table is what index -1 reads.
    labels = np.append(order[new_label], -1).astype(np.int32)[labels]
    return PlaneDetection(_lift(frame, depth, lens, labels, moments, config), labels)


def _noise(z: np.ndarray, scale: float) -> np.ndarray:
    return scale * axial_sigma(z)


def _block_regions(
    depth: np.ndarray, lens: np.ndarray, size: int, config: PlaneDetectionConfig
) -> tuple[np.ndarray, np.ndarray]:  # block labels [By, Bx], planes [S, 5]
    scale = config.depth_noise_scale
    moments = kernels.block_moments(depth, lens, size, config.max_depth)
    shape = moments.shape[:2]
    flat = moments.reshape(-1, kernels.MOMENTS)
    planes, mean = kernels.fit_planes(flat)
    needed = max(3.0, config.block_valid_share * size * size)
    limit = config.block_sigma * _noise(mean[:, 2], scale) + config.block_tolerance
    accepted = (flat[:, 0] >= needed) & (planes[:, 4] < limit)
    # The plane's distance from the camera over the block's: the cosine between ray and normal.
    accepted &= planes[:, 3] > np.cos(np.radians(config.max_incidence_deg)) * np.linalg.norm(mean, axis=1)
    # Standard deviation of the fitted normal in radians: sigma * sqrt(12) / (block edge * sqrt(pixels)), for a square
    # of uniformly spread points; far blocks of a noisy sensor need it.
    edge = np.maximum(mean[:, 2], 1e-3) * size / lens[0]
    tilt = _noise(mean[:, 2], scale) * np.sqrt(12.0) / (edge * size)
    unsure = accepted & (tilt > np.radians(config.window_tilt_deg))
    if unsure.any():
        _steady(moments, planes, mean, tilt, accepted, unsure, size * size, config)
    # Flattest first; a plane that may be tilted starts no region while there is another.
    order = np.lexsort((planes[:, 4], unsure))
    labels = np.full(shape, -1, np.int32)
    regions = np.zeros_like(flat)
    count = kernels.grow_regions(
        kernels.Blocks(
            moments, planes.reshape(*shape, 5), accepted.reshape(shape), config.link_sigma * tilt.reshape(shape)
        ),
        order[accepted[order]], scale, np.radians(config.link_angle_deg), config.link_sigma, config.link_tolerance,
        labels, regions,
    )  # fmt: skip
    if not count:
        return labels, np.zeros((0, 5))
    regions = regions[:count]
    planes, mean = kernels.fit_planes(regions)
    # Blocks miss the rim of a plane: the pixels there come back in the refinement, so half the pixels suffice here.
    keep = regions[:, 0] >= 0.5 * config.min_pixel_share * depth.size
    keep &= planes[:, 4] < config.segment_sigma * _noise(mean[:, 2], scale) + config.segment_tolerance
    # Pieces of one plane that something stands in front of belong together before they are judged one by one.
    merged, new_label = _merge_coplanar(regions[keep], config)
    table = np.full(len(regions) + 1, -1, np.int32)
    table[np.flatnonzero(keep)] = new_label
    return table[labels], kernels.fit_planes(merged)[0]


def _steady(
    moments: np.ndarray,  # [By, Bx, 10]
    planes: np.ndarray,  # [B, 5], changed
    mean: np.ndarray,  # [B, 3]
    tilt: np.ndarray,  # [B] radians, changed
    accepted: np.ndarray,  # [B] bool
    unsure: np.ndarray,  # [B] bool, changed: those that stay unsure
    block_pixels: int,  # in a full block
    config: PlaneDetectionConfig,
) -> None:
    """Give unsure blocks the normal of the 3 x 3 blocks around them where these lie on one plane.

    Far away a block is as thick with noise as it is wide and its plane is arbitrary (36 degrees off at 5 m); larger
    blocks everywhere would lose what is narrow.
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
    planes[at, 3] = -np.einsum("ij,ij->i", fitted[:, :3], mean[at])  # through the block's own centroid
    planes[at, 4] = fitted[:, 4]
    tilt[at] /= 9.0  # three times as wide, nine times as many pixels
    unsure[at] = False


def _refine(
    depth: np.ndarray,
    lens: np.ndarray,
    size: int,
    block_labels: np.ndarray,
    planes: np.ndarray,
    config: PlaneDetectionConfig,
) -> tuple[np.ndarray, np.ndarray]:  # labels [H, W], planes [T, 5]
    """Pixels choose their plane; planes that larger ones explain are taken out and their pixels choose again.

    Noise breaks a tilted piece out of a wall now and then, and blocks across a far edge look like a chamfer.
    """
    scale = config.depth_noise_scale
    edge_on = np.cos(np.radians(config.max_incidence_deg))
    pixel = (scale, config.pixel_sigma, config.pixel_tolerance, config.max_depth, edge_on)
    labels = kernels.refine_pixels(depth, lens, kernels.Choice(size, block_labels, planes), *pixel)
    shares = kernels.explained_shares(
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
) -> tuple[np.ndarray, np.ndarray]:  # moments [T, 10], new label of every old one [S]
    """Join segments of one plane, closest pair first, refitting after every join."""
    limits = (
        config.merge_sigma, config.merge_tolerance, config.merge_back, cosine_deg(config.merge_angle_deg),
        config.merge_wide_sigma, config.merge_wide_tolerance, cosine_deg(config.merge_wide_angle_deg),
        config.merge_reach,
    )  # fmt: skip
    moments = moments.copy()
    alive, label = kernels.merge_coplanar(moments, config.depth_noise_scale, limits)
    table = np.cumsum(alive) - 1
    return moments[alive], np.where(alive[label], table[label], -1)


@cache
def cosine_deg(degrees: float) -> float:
    """Cosine of an angle in degrees, kept: thresholds are asked for again and again."""
    return float(np.cos(np.radians(degrees)))


def _keep_large(moments: np.ndarray, min_pixels: float) -> tuple[np.ndarray, np.ndarray]:
    """Segments with enough pixels, largest first, and the table from old to new label (last entry: -1 for none)."""
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
    # 3 degrees: closer to edge-on a pixel's footprint says nothing about area.
    areas = kernels.segment_areas(depth, lens, labels, planes, np.sin(np.radians(3.0)))
    rotation = frame.world_from_camera[:3, :3]
    normals = planes[:, :3] @ rotation.T
    centroids = transform_points(frame.world_from_camera, mean)
    offsets = -np.einsum("ij,ij->i", normals, centroids)
    # Every how many pixels one is kept, and where those of each segment begin.
    pixels = np.bincount(labels.ravel() + 1, minlength=len(moments) + 1)[1:]
    steps = -(-pixels // config.max_points)
    ends = np.cumsum(-(-pixels // np.maximum(steps, 1)))
    points = kernels.spread_points(depth, lens, labels, steps, ends)
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
