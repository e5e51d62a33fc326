"""Check whether a trajectory is possible in a scene, and find the convention of axes that fits it best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.axes import AXES, in_our_axes

# Largest share of poses outside the free space that is accepted (own choice). It is not 0, because the free space has
# room for the agent's body, and a hand-held camera can have been in a narrower corner.
TOLERATED = 0.02
# Limits of the cosine between the image's up direction and the world's up direction: 60 and 45 degrees (own choice).
# If the median is below `_TILTED`, the cameras are on their side or upside down, and the convention is probably wrong.
# Only a convention with a median above `_UPRIGHT` is suggested.
_TILTED, _UPRIGHT = 0.5, 0.7


@dataclass(frozen=True)
class Fit:
    """Hold how well the poses of a file fit a scene if they are read in one convention of axes."""

    axes: str  # convention, one of `AXES`
    inverted: bool  # whether the poses are read as camera_from_world
    outside: int  # number of poses in walls, in furniture or outside the rooms
    poses: int  # number of all poses
    upright: float  # -1..1, median cosine between the image's up direction and the world's up direction
    lowest: float  # 10th percentile of the same cosine

    @property
    def inside(self) -> bool:
        """Return whether at most the share `TOLERATED` of the poses is outside the free space."""
        return self.outside <= TOLERATED * self.poses

    @property
    def words(self) -> str:
        """Return the convention as options of ``asg replay-trajectory``."""
        return f"--axes {self.axes}" + (" --inverted" if self.inverted else "")


def fit_of(clearance_at: Callable[[np.ndarray], np.ndarray], poses: np.ndarray, axes: str, inverted: bool) -> Fit:
    """Return how well ``poses`` [T, 4, 4], as read from a file, fit a scene if they have the convention ``axes``.

    ``clearance_at`` maps positions [N, 3] in metres to distances [N] from obstacles, which are 0 outside the free space
    of the scene. If ``inverted``, the poses are camera_from_world.
    """
    ours = in_our_axes(poses, axes, inverted=inverted)
    return _measured(clearance_at, ours, axes, inverted)


def _measured(clearance_at: Callable[[np.ndarray], np.ndarray], ours: np.ndarray, axes: str, inverted: bool) -> Fit:
    outside = int(np.count_nonzero(~(clearance_at(ours[:, :3, 3]) > 0)))
    lowest, upright = np.quantile(-ours[:, 2, 1], [0.1, 0.5])
    return Fit(axes, inverted, outside, len(ours), float(upright), float(lowest))


def likeliest(
    clearance_at: Callable[[np.ndarray], np.ndarray],
    poses: np.ndarray,  # [T, 4, 4] as read from a file
) -> Fit | None:
    """Return the fit of the most likely convention of ``poses``, or None if no convention fits.

    A convention fits if the poses are inside the free space and the cameras are upright. world_from_camera is preferred
    to camera_from_world, then the convention with the most upright cameras. ``clearance_at`` is as in `fit_of`.
    """
    fits = [fit_of(clearance_at, poses, axes, inverted) for inverted in (False, True) for axes in AXES]
    good = [fit for fit in fits if fit.inside and fit.upright > _UPRIGHT]
    return max(good, key=lambda fit: (not fit.inverted, fit.upright), default=None)


def with_w_first(poses: np.ndarray) -> np.ndarray:  # [T, 4, 4] -> [T, 4, 4]
    """Correct poses whose quaternions are stored as w x y z but were read as x y z w."""
    turned = poses.copy()
    read = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    turned[:, :3, :3] = Rotation.from_quat(np.roll(read, -1, axis=1)).as_matrix()
    return turned


def checked(
    clearance_at: Callable[[np.ndarray], np.ndarray],
    poses: np.ndarray,  # [T, 4, 4] as read from the file
    placed: np.ndarray,  # [T, 4, 4] world_from_camera of the same poses, in the frame of the scene
    axes: str,
    inverted: bool,
    name: str,  # of the trajectory, for error messages
    *,
    quaternions: bool = False,  # whether the file stores rotations as quaternions
) -> Fit:
    """Return how well a trajectory fits a scene; raise `InputError` if it leaves the free space or is upside down.

    ``axes`` and ``inverted`` are the convention in which ``poses`` were converted to ``placed``. The error message
    names a convention that fits, or the order w x y z of quaternions if that fits better. Tilted cameras inside the
    free space are an error only if such a change makes them upright. ``clearance_at`` is as in `fit_of`.
    """
    found = _measured(clearance_at, placed, axes, inverted)
    steady = found.upright >= _TILTED and (found.lowest >= 0 or not quaternions)
    if found.inside and steady:
        return found
    other = likeliest(clearance_at, poses)
    if other is not None and (other.axes, other.inverted) == (axes, inverted):
        other = None  # the convention is right; the cause is --start or the order of quaternions
    reordered = fit_of(clearance_at, with_w_first(poses), axes, inverted) if quaternions else None
    w_first = (
        reordered is not None and reordered.inside and reordered.lowest > max(_TILTED, other.lowest if other else -1)
    )
    if found.inside and not w_first and (other is None or found.upright >= _TILTED):
        return found
    wrong = (
        f"{found.outside} of the {found.poses} poses of '{name}' are in walls, in furniture or outside of the rooms"
        if not found.inside
        else f"read with axes {axes}, the camera of '{name}' is upside down or on its side"
    )
    if w_first:
        raise InputError(f"{wrong}; with quaternions as w x y z it is upright: write them as x y z w")
    if other is not None:
        raise InputError(f"{wrong}; the most likely convention is {other.words}")
    raise InputError(
        f"{wrong}, in every known convention ({', '.join(AXES)}). Check the units (metres) and the frame. "
        "If the frame is that of the first camera, give its pose by --start x,y,z,yaw; for any other frame, use "
        "--align with a --reference"
    )
