"""An analytic room to map: a box seen from inside, with colours that are functions of the position."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame

ROOM = np.array([4.0, 3.0, 2.5])  # metres, one corner at the origin
CAMERA = PinholeCamera.from_size(80, 45)


def _render_room(world_from_camera, camera=CAMERA, supersample=3):
    """Exact depth through the pixel centres, colour averaged over supersample^2 rays per pixel."""
    center = camera.rays() @ world_from_camera[:3, :3].T
    fine = camera.rays(supersample) @ world_from_camera[:3, :3].T
    position = world_from_camera[:3, 3]
    depth = _exit_distance(position, center)
    points = position + _exit_distance(position, fine)[..., None] * fine
    color = _color(points).reshape(camera.height, supersample, camera.width, supersample, 3).mean(axis=(1, 3))
    return Frame((255 * color).round().astype(np.uint8), depth.astype(np.float32), world_from_camera, camera)


def _exit_distance(position, directions):
    towards = np.where(directions > 0, ROOM - position, -position)
    return (towards / np.where(np.abs(directions) < 1e-12, -1e-12, directions)).min(axis=-1)


def _color(points):
    x, y, z = np.moveaxis(points, -1, 0)
    waves = [np.sin(2.1 * x + 1.3 * y - 0.7 * z), np.sin(1.7 * y - 2.3 * z), np.cos(1.1 * x - 0.9 * y + 2.9 * z)]
    tiles = (np.floor(2 * x + 1e-6) + np.floor(2 * y + 1e-6) + np.floor(2 * z + 1e-6)) % 2
    return np.clip(0.5 + 0.2 * np.stack(waves, axis=-1) + 0.15 * (tiles[..., None] - 0.5), 0, 1)


def turning_poses(count, *, radius=0.6, height=1.2, phase=0.0, tilt=0.35):
    """Cameras on a circle around the room's middle, looking outwards, up and down in turn."""
    angles = phase + 2 * np.pi * np.arange(count) / count
    directions = np.stack([np.cos(angles), np.sin(angles), tilt * (-1.0) ** np.arange(count)], axis=1)
    positions = np.array([ROOM[0] / 2, ROOM[1] / 2, height]) + radius * directions * [1, 1, 0]
    return [look_along(p, d) for p, d in zip(positions, directions)]


@pytest.fixture(scope="session")
def render_room():
    """Pose -> frame."""
    return _render_room


@pytest.fixture(scope="session")
def room_frames():
    """Twelve frames around the room."""
    return [_render_room(pose) for pose in turning_poses(12)]


@pytest.fixture(scope="session")
def held_out_frames():
    """Six views of the same part of the room from other positions and directions."""
    return [_render_room(pose) for pose in turning_poses(6, radius=0.4, height=1.3, phase=0.26, tilt=0.1)]
