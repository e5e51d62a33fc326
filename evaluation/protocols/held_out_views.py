"""Create held-out views: true colour and depth images that are compared with renderings of a finished map."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.ground_truth import FreeSpace, GroundTruth
from activestructure_gym.scenes.cache import cached_arrays
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.renderer import drawn_images

# Steeper views show mostly the floor or the ceiling. With 45 degrees all furniture can be visible.
_MAX_PITCH_DEG = 45.0
_MIN_CLEARANCE = 0.3  # metres from the camera to the nearest surface, as for candidate views

# Increase the version when the drawing or the rendering of views changes, so that old cache files are not read.
_CACHE_VERSION = 2
_LAYOUT = {"world_from_camera": ("f8", 3), "rgb": ("u1", 4), "depth": ("f4", 3)}


@dataclass(frozen=True)
class HeldOutViews:
    """Hold true images of a scene at poses that planners do not get."""

    camera: PinholeCamera
    world_from_camera: np.ndarray  # [V, 4, 4]
    rgb: np.ndarray  # [V, H, W, 3] uint8
    depth: np.ndarray  # [V, H, W] float32 metres, 0 = no surface

    def __len__(self) -> int:
        return len(self.rgb)


def free_space_views(
    known: GroundTruth,
    *,
    count: int,
    camera: PinholeCamera,
    supersample: int = 4,  # 4 x 4 rays per pixel, against aliasing in the true images
) -> HeldOutViews:
    """Draw ``count`` views uniformly in the scene's free space, equal in every run on this scene.

    The first n views do not depend on ``count``. The images are rendered once and cached by the scene's content. Raise
    `InputError` for a scene without free space, and for more than 1024 views.
    """
    if count > _POSES_DRAWN:
        raise InputError(f"at most {_POSES_DRAWN} held-out views can be drawn, got {count}")
    scene = known.scene
    key = f"views-v{_CACHE_VERSION}-{scene.content_hash[:32]}-{count}-{camera}-{supersample}"
    arrays = cached_arrays(key, lambda: _render(scene, _draw_poses(known, count), camera, supersample), _LAYOUT)
    return HeldOutViews(camera, arrays["world_from_camera"], arrays["rgb"], arrays["depth"])


def posed_views(scene: Scene, poses: np.ndarray, *, camera: PinholeCamera, supersample: int) -> HeldOutViews:
    """Render the scene at ``poses`` [V, 4, 4] world_from_camera, with ``supersample`` rays per pixel and axis.

    The result is cached by the scene's content and the poses.
    """
    digest = hashlib.sha256(np.ascontiguousarray(poses, dtype="<f8").tobytes()).hexdigest()[:16]
    key = f"posed-views-v{_CACHE_VERSION}-{scene.content_hash[:32]}-{digest}-{camera}-{supersample}"
    arrays = cached_arrays(key, lambda: _render(scene, poses, camera, supersample), _LAYOUT)
    return HeldOutViews(camera, arrays["world_from_camera"], arrays["rgb"], arrays["depth"])


def roomiest_circle(space: FreeSpace) -> tuple[tuple[float, float, float], float]:  # centre, radius in metres
    """Return a horizontal circle of at most 1 m radius around the free point that is farthest from all surfaces.

    The radius is the clearance of this point minus 0.3 m (the clearance of held-out views), but at least half of the
    clearance.
    """
    voxel = np.unravel_index(int(space.clearance.argmax()), space.clearance.shape)
    clearance = float(space.clearance[voxel])
    x, y, z = (float(value) for value in space.centers(np.array(voxel)))
    return (x, y, z), min(1.0, max(clearance - _MIN_CLEARANCE, 0.5 * clearance))


def recorded_views(scene: Scene, *, count: int) -> HeldOutViews:
    """Return up to ``count`` views of the scene's recorded sequence, evenly spaced; raise `InputError` without one."""
    sequence = scene.evaluation_views
    if sequence is None or not len(sequence):
        raise InputError(f"scene '{scene.name}' came without recorded views; use views drawn in free space instead")
    chosen = np.unique(np.linspace(0, len(sequence) - 1, min(count, len(sequence))).round().astype(int))
    frames = [sequence.frame(int(index)) for index in chosen]
    return HeldOutViews(
        camera=frames[0].camera,
        world_from_camera=np.stack([frame.world_from_camera for frame in frames]),
        rgb=np.stack([frame.rgb for frame in frames]),
        depth=np.stack([frame.depth for frame in frames]),
    )


def _draw_poses(known: GroundTruth, count: int) -> np.ndarray:  # [count, 4, 4]
    seed = int(known.scene.draw_key[:16], 16)
    positions, directions = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    # Directions are uniform on a band of the unit sphere. The height of such a point is uniform (Archimedes).
    height = np.sin(np.radians(_MAX_PITCH_DEG)) * directions.uniform(-1.0, 1.0, _POSES_DRAWN)[:count]
    azimuth = directions.uniform(0.0, 2.0 * np.pi, _POSES_DRAWN)[:count]
    across = np.sqrt(1.0 - height**2)
    looking = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=1)
    places = known.free_space.sample_positions(_POSES_DRAWN, positions, min_clearance=_MIN_CLEARANCE)[:count]
    return np.stack([look_along(place, direction) for place, direction in zip(places, looking)])


# So many poses are always drawn, and the first ``count`` are used. So the first n views do not depend on ``count``.
_POSES_DRAWN = 1024


def _render(scene: Scene, poses: np.ndarray, camera: PinholeCamera, supersample: int) -> dict[str, np.ndarray]:
    images = list(drawn_images(scene, camera, poses, supersample=supersample))
    return {
        "world_from_camera": poses,
        "rgb": np.stack([rgb for rgb, _ in images]),
        "depth": np.stack([depth for _, depth in images]),
    }
