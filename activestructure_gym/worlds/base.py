"""Define the interface of a world: what the planner needs of a simulator, a recording or a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeGuard

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.motion import unrounded_start
from activestructure_gym.ranges import MAX_COORDINATE_M, POSE_ROUNDING


@dataclass(frozen=True)
class Start:
    """Hold the start of an episode.

    Parameters
    ----------
    pose
        ``world_from_camera`` [4, 4] of the camera now. Camera axes: x right, y down, z forward.
    free_radius
        Radius in metres of a sphere around the camera that is known to be free. It contains the agent's body.
    """

    pose: np.ndarray
    free_radius: float = 0.6


@dataclass(frozen=True)
class Views:
    """Hold the only poses that a world can capture, such as those of a recording.

    Parameters
    ----------
    world_from_camera
        Poses [M, 4, 4].
    free_radius
        [M] metres: radius of a sphere around each pose that is known to be free.
    """

    world_from_camera: np.ndarray
    free_radius: np.ndarray

    def __post_init__(self) -> None:
        poses, radii = np.shape(self.world_from_camera), np.shape(self.free_radius)
        if len(poses) != 3 or poses[1:] != (4, 4) or not poses[0] or radii != poses[:1]:
            raise InputError(f"views are poses [M, 4, 4] with a free radius each [M], M >= 1; got {poses} and {radii}")


class World(Protocol):
    """Define what an episode explores: a simulator, a recording, a robot. Positions are in metres, z is up.

    Further attributes are optional:

    - ``truth``, a `GroundTruth`: the environment's reward uses it; planners and metrics of runs never do.
    - ``travel(path)``, called before each capture with the poses [P, 4, 4] that lead to it, one per frame. The first
      one follows the current pose, the last one is the pose of the capture. A robot drives along them; `capture` is
      then called for the last one.
    - ``views``, the `Views` of a world that can capture given poses only. The shared pool then offers these poses,
      without their roll. Keyframes on a path are taken only where a view is within one frame's step and turn.
    - ``reset(seed)``, called when an episode begins, before ``start`` is read. A simulator returns to a start pose.

    Examples
    --------
    >>> from activestructure_gym.worlds import load_world
    >>> world = load_world("simulated?scene=box&width=64&height=48")
    >>> world.bounds.shape, world.capture(world.start.pose).depth.shape
    ((2, 3), (48, 64))
    >>> world.close()
    """

    @property
    def bounds(self) -> np.ndarray:
        """Return the lowest and the highest corner [2, 3] of the space to explore."""

    @property
    def camera(self) -> PinholeCamera:
        """Return the intrinsics of the images that `capture` returns; any pinhole camera without distortion."""

    @property
    def start(self) -> Start:
        """Return the camera's current pose, and the radius known to be free around it."""

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Go to a pose [4, 4], or render there, and return the frame taken.

        ``Frame.world_from_camera`` is the pose where the frame was taken, as accurately as the world measures it. Depth
        is in metres along the optical axis. 0 and NaN mean not measured, infinite depth that the ray meets no surface.
        Raise `CaptureFailed` if no frame can be taken.
        """

    def close(self) -> None:
        """Release all resources of the world; may be called twice."""


class CaptureFailed(RuntimeError):
    """Report that a world could not take a frame, for example since the robot does not reach the pose.

    The planner then chooses another view. The fourth failure in a row ends the episode with this error.
    """


def is_world(value: Any) -> TypeGuard[World]:
    """Return whether ``value`` has the five members of `World`."""
    return not isinstance(value, type) and all(
        hasattr(type(value), name) or name in getattr(value, "__dict__", ())
        for name in ("bounds", "camera", "start", "capture", "close")
    )


def captured(world: World, world_from_camera: np.ndarray) -> Frame:
    """Return the frame that the world takes at a pose [4, 4]; raise `InputError` if it returns no frame."""
    frame = world.capture(world_from_camera)
    if not all(hasattr(frame, name) for name in ("rgb", "depth", "world_from_camera")):
        raise InputError(
            f"capture() of {type(world).__name__} must return a Frame, or raise CaptureFailed; got {short_repr(frame)}"
        )
    return frame


def checked_bounds(bounds: Any) -> np.ndarray:  # [2, 3] float64
    """Return bounds as an array; raise `InputError` unless they are two corners with a volume between them."""
    try:
        array = np.array(bounds, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"bounds are the lowest and the highest corner in metres, got {short_repr(bounds)}") from error
    if array.shape != (2, 3) or not np.isfinite(array).all() or not (array[0] < array[1]).all():
        raise InputError(f"bounds are the lowest and the highest corner [2, 3] in metres, got {short_repr(bounds)}")
    if np.abs(array).max() > MAX_COORDINATE_M:
        raise InputError(f"bounds must be within {MAX_COORDINATE_M:g} m of the origin, got {array.tolist()}")
    return array


def checked_pose(what: str, pose: Any) -> np.ndarray:  # [4, 4] float64
    """Return a pose with an orthonormal rotation; raise `InputError` unless it is nearly a rigid motion.

    A rotation rounded to three decimals is accepted; a level pose (without roll) remains level. ``what`` begins the
    message.
    """
    try:
        array = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} is a 4x4 world_from_camera matrix, got {short_repr(pose)}") from error
    if array.shape != (4, 4) or not np.isfinite(array).all():
        raise InputError(f"{what} is a finite 4x4 world_from_camera matrix, got {short_repr(pose)}")
    rotation = array[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > POSE_ROUNDING or np.linalg.det(rotation) < 0 or np.abs(array[3] - (0, 0, 0, 1)).max() > POSE_ROUNDING:
        raise InputError(f"{what} must be a rigid motion (rotation and translation), got {array.round(3).tolist()}")
    return unrounded_start(array)


def checked_views(views: Views, bounds: np.ndarray) -> Views:
    """Return the views inside the bounds; raise `InputError` if none is, or for an invalid pose or radius."""
    radii = np.asarray(views.free_radius, dtype=np.float64)
    if not (radii >= 0.0).all():
        raise InputError(f"the free_radius of a view must be 0 m or more, got {radii[~(radii >= 0.0)][0]}")
    poses = np.stack([checked_pose(f"view {n}", pose) for n, pose in enumerate(views.world_from_camera)])
    inside = ((poses[:, :3, 3] >= bounds[0]) & (poses[:, :3, 3] <= bounds[1])).all(axis=1)
    if not inside.any():
        raise InputError(f"none of the {len(poses)} views is inside the world's bounds {bounds.round(3).tolist()}")
    return Views(poses[inside], radii[inside])


def checked_start(start: Start, bounds: np.ndarray) -> Start:
    """Return a start with a checked pose; raise `InputError` outside the bounds, or for a radius not above 0."""
    pose = checked_pose("a world's start pose", start.pose)
    position = pose[:3, 3]
    if (position < bounds[0]).any() or (position > bounds[1]).any():
        raise InputError(
            f"the start at {position.round(3).tolist()} is outside the world's bounds, which go from "
            f"{bounds[0].round(3).tolist()} to {bounds[1].round(3).tolist()}"
        )
    radius = start.free_radius
    if isinstance(radius, bool) or not isinstance(radius, int | float | np.number) or not 0 < radius < 1000:
        raise InputError(f"a start's free_radius is a number of metres above 0, got {short_repr(radius)}")
    return Start(pose, float(radius))
