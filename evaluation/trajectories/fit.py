"""Whether a camera can have been where a trajectory says, in a scene, and which convention fits better if not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.axes import AXES, in_our_axes

# Share of poses outside of the free space that are reported and not refused: free space is one region with room for a
# body, and a camera that a hand carried may have been in a corner that has none (own choice).
TOLERATED = 0.02
# Cosine between the image's up and the world's, in the middle of all poses: below, cameras lie on their side or hang
# upside down, which a wrong convention makes of an upright one (own choice, 60 and 45 degrees).
_TILTED, _UPRIGHT = 0.5, 0.7


@dataclass(frozen=True)
class Fit:
    """How a trajectory lies in a scene, read in one convention."""

    axes: str
    inverted: bool
    outside: int  # poses in walls, in furniture or outside of the rooms
    poses: int  # of all
    upright: float  # -1..1, median cosine between the image's up and the world's
    lowest: float  # the same where a tenth of the poses is below

    @property
    def inside(self) -> bool:
        """Whether the poses stand in the free space, but for a few."""
        return self.outside <= TOLERATED * self.poses

    @property
    def words(self) -> str:
        """The convention as options."""
        return f"--axes {self.axes}" + (" --inverted" if self.inverted else "")


def fit_of(clearance_at: Callable[[np.ndarray], np.ndarray], poses: np.ndarray, axes: str, inverted: bool) -> Fit:
    """How ``poses`` [T, 4, 4], as a file has them, fit; ``clearance_at`` [N, 3] -> [N] is 0 where nothing is free."""
    ours = in_our_axes(poses, axes, inverted=inverted)
    return _measured(clearance_at, ours, axes, inverted)


def _measured(clearance_at: Callable[[np.ndarray], np.ndarray], ours: np.ndarray, axes: str, inverted: bool) -> Fit:
    outside = int(np.count_nonzero(~(clearance_at(ours[:, :3, 3]) > 0)))
    lowest, upright = np.quantile(-ours[:, 2, 1], [0.1, 0.5])
    return Fit(axes, inverted, outside, len(ours), float(upright), float(lowest))


def likeliest(
    clearance_at: Callable[[np.ndarray], np.ndarray],
    poses: np.ndarray,  # [T, 4, 4] as a file has them
) -> Fit | None:
    """The convention in which the poses stand in the free space and the cameras upright, the most upright of several;
    None where there is none."""
    fits = [fit_of(clearance_at, poses, axes, inverted) for inverted in (False, True) for axes in AXES]
    good = [fit for fit in fits if fit.inside and fit.upright > _UPRIGHT]
    return max(good, key=lambda fit: (not fit.inverted, fit.upright), default=None)


def with_w_first(poses: np.ndarray) -> np.ndarray:  # [T, 4, 4] -> [T, 4, 4]
    """What the poses would be if their file had quaternions in the order w x y z, read as x y z w."""
    turned = poses.copy()
    read = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    turned[:, :3, :3] = Rotation.from_quat(np.roll(read, -1, axis=1)).as_matrix()
    return turned


def checked(
    clearance_at: Callable[[np.ndarray], np.ndarray],
    poses: np.ndarray,  # [T, 4, 4] as the file has them
    placed: np.ndarray,  # [T, 4, 4] world_from_camera, as they are to be used
    axes: str,
    inverted: bool,
    name: str,  # of the trajectory, for people
    *,
    quaternions: bool = False,  # whether the file has them
) -> Fit:
    """How the trajectory lies in the scene; raises `InputError` where it leaves the free space or hangs upside down.

    The message names the convention that fits, where one does, or else the other order of quaternions. Tilted cameras
    alone are refused only if one of these makes them upright.
    """
    found = _measured(clearance_at, placed, axes, inverted)
    steady = found.upright >= _TILTED and (found.lowest >= 0 or not quaternions)
    if found.inside and steady:
        return found
    other = likeliest(clearance_at, poses)
    if other is not None and (other.axes, other.inverted) == (axes, inverted):  # moved by --start, or the order
        other = None
    reordered = fit_of(clearance_at, with_w_first(poses), axes, inverted) if quaternions else None
    w_first = (
        reordered is not None and reordered.inside and reordered.lowest > max(_TILTED, other.lowest if other else -1)
    )
    if found.inside and not w_first and (other is None or found.upright >= _TILTED):
        return found
    wrong = (
        f"{found.outside} of the {found.poses} poses of '{name}' lie in walls, in furniture or outside of the rooms"
        if not found.inside
        else f"read with axes {axes}, the camera of '{name}' hangs upside down or lies on its side"
    )
    if w_first:
        raise InputError(f"{wrong}; with quaternions as w x y z it is upright: write them as x y z w")
    if other is not None:
        raise InputError(f"{wrong}; the most likely convention is {other.words}")
    raise InputError(
        f"{wrong}, in every convention that is known ({', '.join(AXES)}): check units (metres) and the frame; "
        "--start x,y,z,yaw says where a trajectory in its first camera's frame begins"
    )
