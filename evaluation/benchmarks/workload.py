"""Make the maps and cameras of the splatting benchmark.

A workload is a map and one or more cameras (sizes: docs/notebook/lab_notes.md). The Gaussians are disks at the RGB-D
pixels of six views of a furnished box room. The first view is the target image. W1 has 160 x 120 pixels and 20,000
Gaussians, W2 320 x 240 and 80,000, W3 640 x 480 and 300,000; W4 has 64 cameras of 80 x 60 pixels and 50,000 Gaussians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from activestructure_gym.errors import unknown_name
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.splatting import layout
from activestructure_gym.splatting.workspace import aligned_zeros

WORKLOADS = ("W1", "W2", "W3", "W4")
# Width and height in pixels, and number of Gaussians, by workload.
SIZES = {"W1": (160, 120, 20_000), "W2": (320, 240, 80_000), "W3": (640, 480, 300_000), "W4": (80, 60, 50_000)}
# Lower and upper corners of the room, and of the boxes in it, in metres.
_ROOM = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 2.8]])
_BOXES = np.array([
    [[0.5, 0.4, 0.0], [1.5, 1.9, 0.7]], [[4.6, 0.3, 0.0], [5.6, 1.1, 1.9]], [[2.4, 4.2, 0.0], [4.0, 4.9, 0.9]],
    [[0.2, 3.9, 0.0], [0.9, 4.8, 2.0]], [[5.0, 3.0, 0.0], [5.8, 4.4, 0.5]], [[2.7, 0.2, 0.0], [3.5, 0.8, 1.1]],
])  # fmt: skip


@dataclass(frozen=True)
class Workload:
    """Hold a Gaussian map, the cameras that render it, and the target image."""

    parameters: np.ndarray  # [14, capacity] float32
    count: int  # number of Gaussians, at most the capacity
    camera: PinholeCamera
    poses: np.ndarray  # [C, 4, 4] world_from_camera
    target_rgb: np.ndarray  # [H, W, 3] float32, colour of the first view
    target_depth: np.ndarray  # [H, W] float32 metres, depth of the first view


def make_workload(name: str, seed: int = 0) -> Workload:
    """Build the workload ``name``, one of W1 to W4; equal seeds give equal workloads."""
    if name not in SIZES:
        raise unknown_name("splatting workload", name, SIZES)
    width, height, count = SIZES[name]
    rng = np.random.default_rng(seed)
    camera = PinholeCamera.from_size(width, height)
    # Neighbouring views of W1 to W3 overlap, since their headings differ by 50 degrees. W4 has 64 headings all around.
    poses = _poses(np.radians([0, 50, -50, 100, -100, 150]) if name != "W4" else np.arange(64) / 32 * np.pi, rng)
    sources = poses if name != "W4" else poses[::11]
    per_view = -(-count // 6)
    # The Gaussians of W4 come from larger images, since 80 x 60 pixels are too few for them.
    seeding = camera if name != "W4" else PinholeCamera.from_size(224, 168)
    blocks = [_seed(seeding, pose, per_view, rng) for pose in sources]
    live = np.concatenate(blocks, axis=1)[:, :count]
    parameters = aligned_map((14, -(-count // 16) * 16))
    parameters[:, :count] = live
    rgb, depth, _ = _see(camera, poses[0])
    return Workload(parameters, count, camera, poses, rgb.astype(np.float32), depth.astype(np.float32))


def aligned_map(shape: tuple[int, int]) -> np.ndarray:
    """Return zeros whose rows begin at cache lines, as in the mapper's map."""
    return aligned_zeros(shape[0] * shape[1]).reshape(shape)


def _poses(yaws: np.ndarray, rng: np.random.Generator) -> np.ndarray:  # [C] radians -> [C, 4, 4]
    """Draw camera poses (world_from_camera) near the middle of the room, one per heading in ``yaws``."""
    poses = []
    for yaw in yaws:
        position = np.array([3.0, 2.5, 1.4]) + rng.uniform(-0.6, 0.6, 3) * [1.0, 1.0, 0.4]
        poses.append(look_along(position, np.array([np.cos(yaw), np.sin(yaw), rng.uniform(-0.3, 0.1)])))
    return np.stack(poses)


def _see(camera: PinholeCamera, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render the box room by slab intersection: colour [H, W, 3], depth [H, W] in metres, and normals [H, W, 3]."""
    directions = camera.rays().astype(np.float64) @ pose[:3, :3].T
    origin = pose[:3, 3]
    walls = np.where(directions > 0, _ROOM[1] - origin, _ROOM[0] - origin) / directions
    axis, depth = walls.argmin(axis=-1), walls.min(axis=-1)
    for low, high in _BOXES:
        a, b = (low - origin) / directions, (high - origin) / directions
        near, far = np.minimum(a, b), np.maximum(a, b).min(axis=-1)
        enters = near.max(axis=-1)
        hit = (enters > 0) & (enters < far) & (enters < depth)
        depth, axis = np.where(hit, enters, depth), np.where(hit, near.argmax(axis=-1), axis)
    normals = np.eye(3)[axis] * -np.sign(np.take_along_axis(directions, axis[..., None], axis=-1))
    points = origin + directions * depth[..., None]
    waves = np.sin(points @ np.array([[9.0, 4.0, 2.0], [3.0, 11.0, 5.0], [6.0, 2.0, 13.0]]))
    return 0.5 + 0.2 * normals + 0.25 * waves, depth, normals


def _seed(camera: PinholeCamera, pose: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:  # [14, count]
    """Return ``count`` Gaussians as disks on the surfaces at random pixels of a view, in raster order.

    Their sigma in the image, including the rasteriser's blur, is 1.0 to 1.5 pixels.
    """
    rgb, depth, normals = _see(camera, pose)
    pixels = np.sort(rng.choice(depth.size, count, replace=count > depth.size))
    z = depth.reshape(-1)[pixels]
    points = pose[:3, 3] + (camera.rays().reshape(-1, 3)[pixels] @ pose[:3, :3].T) * z[:, None]
    normal = normals.reshape(-1, 3)[pixels]
    quaternion = np.concatenate([1.0 + normal[:, 2:], np.cross([0.0, 0.0, 1.0], normal)], axis=1)
    quaternion[normal[:, 2] < -0.5] = [0.0, 1.0, 0.0, 0.0]  # a half turn, since the formula fails for (0, 0, -1)
    sigma = np.sqrt(rng.uniform(1.0, 1.5, count) ** 2 - layout.BLUR_VARIANCE) * z / camera.fx
    opacity = rng.uniform(0.5, 0.95, count)
    return np.concatenate([
        points.T, quaternion.T, np.log(sigma)[None], np.log(sigma)[None], np.log(0.1 * sigma)[None],
        np.log(opacity / (1.0 - opacity))[None], rgb.reshape(-1, 3)[pixels].T,
    ])  # fmt: skip
