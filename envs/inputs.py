"""Convert what users give an environment: scenes and worlds, start poses, tables of options; warn of a bad start."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.envs.observation import MAX_DISTANCE_M
from activestructure_gym.errors import InputError, InputWarning, short_repr
from activestructure_gym.geometry import look_along
from activestructure_gym.ground_truth import GroundTruth, Layout, ground_truth_of, warn_if_hardly_seen
from activestructure_gym.motion import unrounded_start
from activestructure_gym.ranges import POSE_ROUNDING
from activestructure_gym.scenes import Scene, load_scene
from activestructure_gym.worlds import World, is_world, load_world, names_world

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction

SceneSpec = str | PathLike[str] | Scene | GroundTruth | Layout | World
Scenes = SceneSpec | Sequence[SceneSpec]


def only_world(scenes: Sequence[SceneSpec], start_pose: Any) -> World | None:
    """Return the world that an environment explores; None if it explores scenes.

    Raise `InputError` for a world among several scenes, and for a world with a ``start_pose``.
    """
    worlds = [one for one in scenes if names_world(one) or is_world(one)]
    if not worlds:
        return None
    if len(scenes) > 1:
        raise InputError("an environment explores one world: give a sequence of scenes, or a single world")
    if start_pose is not None:
        raise InputError("a world has its own start pose: leave out start_pose")
    (world,) = worlds
    if isinstance(world, str):
        return load_world(world)
    assert is_world(world)
    return world


def as_truth(scene: SceneSpec) -> GroundTruth:
    """Return the ground truth of a scene or scene spec; warn if only little of its surface can be seen."""
    if isinstance(scene, GroundTruth):
        return scene
    if isinstance(scene, Layout):
        return scene.truth()
    if names_world(scene) or is_world(scene):
        raise InputError(f"a world has no scene to load, got {short_repr(scene)}")
    if not isinstance(scene, str | PathLike | Scene):
        raise InputError(f"scene must be a name, a path or a Scene, got {short_repr(scene)}")
    truth = ground_truth_of(load_scene(scene))
    warn_if_hardly_seen(truth)
    return truth


def as_pose(value: Sequence[float] | np.ndarray) -> np.ndarray:  # [4, 4]
    """Convert a start pose to a ``world_from_camera`` matrix.

    ``value`` is a 4x4 matrix, or (x, y, z, yaw) with a horizontal view direction. Positions are in metres. The yaw is
    in degrees, 0 for +x. Raises `InputError` for other values.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"a start pose is (x, y, z, yaw_deg) or a 4x4 matrix, got {short_repr(value)}") from error
    if not np.isfinite(array).all():
        raise InputError(f"a start pose must be finite numbers, got {short_repr(value)}")
    if array.shape == (4, 4):
        return _rigid(array)
    if array.shape == (4,):
        yaw = np.radians(array[3])
        return look_along(array[:3], np.array([np.cos(yaw), np.sin(yaw), 0.0]))
    raise InputError(f"a start pose is (x, y, z, yaw_deg) or a 4x4 matrix, got shape {array.shape}")


def _rigid(pose: np.ndarray) -> np.ndarray:  # [4, 4]
    """Re-orthonormalise a rotation that was rounded to few digits; return other matrices unchanged.

    Raises `InputError` if the last row is not (0, 0, 0, 1).
    """
    if np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise InputError(f"the last row of a start pose's 4x4 matrix is (0, 0, 0, 1), got {pose[3].tolist()}")
    rotation = pose[:3, :3]
    nearly = np.abs(rotation @ rotation.T - np.eye(3)).max() <= POSE_ROUNDING and np.linalg.det(rotation) > 0
    return unrounded_start(pose) if nearly else pose


def table_of(what: str, value: Any) -> Mapping[str, Any]:
    """Return a mapping with names as keys, {} for None; raise `InputError` for other values of the option ``what``."""
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise InputError(f"{what} must be a dictionary with names as keys, got {short_repr(value)}")
    return value


def warn_of_start(episode: Reconstruction) -> None:
    """Warn of a scene too far from the origin for the observation, and of a start without a candidate view.

    The warnings name the line that calls ``reset()``.
    """
    if (away := float(np.abs(episode.bounds).max())) > MAX_DISTANCE_M:
        warnings.warn(
            f"the scene is {away:,.0f} m from the origin, and the observation limits positions to "
            f"{MAX_DISTANCE_M:,.0f} m, so policies that read positions choose wrong views: move the scene",
            InputWarning,
            stacklevel=4,
        )
    if not len(episode.candidates):
        sources = ", ".join(episode.config.views.stages[0])
        warnings.warn(
            f"no candidate view at the start: none of the views that '{sources}' proposed can be reached through "
            "known free space, so the episode ends with its first step",
            InputWarning,
            stacklevel=4,
        )
