"""Provide worlds: what an episode explores, behind one interface. A scene with the simulated sensor is one of them."""

from activestructure_gym.worlds.base import (
    CaptureFailed,
    Start,
    Views,
    World,
    captured,
    checked_bounds,
    checked_pose,
    checked_start,
    checked_views,
    is_world,
)
from activestructure_gym.worlds.frames import frame_from
from activestructure_gym.worlds.registry import WORLDS, load_world, names_world, with_camera
from activestructure_gym.worlds.reliable import Reliable
from activestructure_gym.worlds.scene_world import SceneWorld
from activestructure_gym.worlds.stored import StoredCaptures

__all__ = [
    "WORLDS",
    "CaptureFailed",
    "Reliable",
    "SceneWorld",
    "Start",
    "StoredCaptures",
    "Views",
    "World",
    "captured",
    "checked_bounds",
    "checked_pose",
    "checked_start",
    "checked_views",
    "frame_from",
    "is_world",
    "load_world",
    "names_world",
    "with_camera",
]
