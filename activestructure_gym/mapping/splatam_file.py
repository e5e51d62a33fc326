"""Read and write Gaussian maps as SplaTAM's ``params.npz``, a checkpoint format that programs based on SplaTAM share.

Array names and conventions are those of [splatam, code]. The map and all poses are in the frame of the first camera.
The original format lacks the world pose of that camera. Files written here add it as ``world_from_first_camera`` [4,
4].
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping

import numpy as np

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.files import replaced
from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.rotations import quaternion_of, turned
from activestructure_gym.mapping.gaussian_map import (
    COLOR,
    LOG_SCALE,
    MEAN,
    OPACITY_LOGIT,
    QUATERNION,
    ROWS,
    GaussianMap,
    usable,
)
from activestructure_gym.npz import read_npz

_PLACE = "world_from_first_camera"  # array name of the world pose of the first camera
_MAX_NUMBER = 1e9  # largest number accepted in a camera, in metres or pixels
# Arrays that every file must have.
_NEEDED = ("means3D", "rgb_colors", "unnorm_rotations", "logit_opacities", "log_scales")


def write_splatam(
    gaussians: GaussianMap,
    path: str | os.PathLike[str],
    world_from_camera: np.ndarray,  # [T, 4, 4]; the file uses the frame of the first pose
    camera: PinholeCamera,
    keyframes: np.ndarray,  # [K] indices of poses that are keyframes
) -> None:
    """Write the Gaussians and the camera poses. An existing file is replaced only when the new one is complete."""
    used = gaussians.parameters[:, : gaussians.count].astype(np.float64)
    poses = np.asarray(world_from_camera, np.float64)
    first = invert_rigid(poses[0])
    in_first = invert_rigid(poses) @ poses[0]  # [T, 4, 4] camera t from camera 0
    content = {
        "means3D": (used[MEAN].T @ first[:3, :3].T + first[:3, 3]).astype(np.float32),
        "rgb_colors": used[COLOR].T.astype(np.float32),
        "unnorm_rotations": turned(quaternion_of(first[:3, :3]), used[QUATERNION].T).astype(np.float32),
        "logit_opacities": used[OPACITY_LOGIT][:, None].astype(np.float32),
        "log_scales": used[LOG_SCALE].T.astype(np.float32),
        "cam_unnorm_rots": np.stack([quaternion_of(pose[:3, :3]) for pose in in_first], axis=1)[None].astype(
            np.float32
        ),
        "cam_trans": in_first[:, :3, 3].T[None].astype(np.float32),
        "timestep": np.zeros(gaussians.count, np.float32),
        "intrinsics": camera.matrix,
        "w2c": np.eye(4),
        "org_width": np.array(camera.width),
        "org_height": np.array(camera.height),
        "gt_w2c_all_frames": in_first,
        _PLACE: poses[0],
        "keyframe_time_indices": np.asarray(keyframes, np.int64),
    }
    with replaced(path) as file:
        np.savez(file, **content)  # type: ignore[arg-type]


def read_splatam(path: str | os.PathLike[str], world_from_first: np.ndarray | None = None) -> GaussianMap:
    """Read a ``params.npz`` and return its Gaussians in the world frame.

    ``world_from_first`` [4, 4] is the world pose of the first camera; None means the pose in the file. Without either,
    the map remains in the frame of the first camera, with a warning. Isotropic scales [N, 1] become balls. Gaussians
    with a value that is not finite are dropped, with a warning. Raises `InputError` for other files.
    """
    content = _read(path)
    for name in _NEEDED:
        if name not in content:
            found = ", ".join(sorted(content)) or "none"
            raise InputError(f"'{path}' is not a SplaTAM params.npz: expected the array '{name}', found {found}")
    count = content["means3D"].shape[0] if content["means3D"].ndim else 0
    widths = {
        "means3D": (3,),
        "rgb_colors": (3,),
        "unnorm_rotations": (4,),
        "logit_opacities": (1,),
        "log_scales": (1, 3),
    }
    for name, allowed in widths.items():
        shape = content[name].shape
        if len(shape) != 2 or shape[0] != count or shape[1] not in allowed or content[name].dtype.kind != "f":
            wanted = " or ".join(f"({count}, {width})" for width in allowed)
            raise InputError(
                f"'{path}': expected '{name}' as floats of shape {wanted}, got {content[name].dtype} {shape}"
            )
    block = np.empty((ROWS, count))
    block[MEAN] = content["means3D"].T
    block[COLOR] = content["rgb_colors"].T
    block[OPACITY_LOGIT] = content["logit_opacities"][:, 0]
    block[LOG_SCALE] = np.broadcast_to(content["log_scales"], (count, 3)).T
    block[QUATERNION] = content["unnorm_rotations"].T
    first = _place(content, path, world_from_first)
    block[MEAN] = first[:3, :3] @ block[MEAN] + first[:3, 3:]
    block[QUATERNION] = turned(quaternion_of(first[:3, :3]), block[QUATERNION].T).T
    with np.errstate(over="ignore"):
        block32 = block.astype(np.float32)
    kept = usable(block32)
    if not kept.all():
        dropped = f"dropped {np.count_nonzero(~kept)} of {count} Gaussians: values not finite, or scales too large"
        warnings.warn(f"'{path}': {dropped}", InputWarning, stacklevel=2)
    gaussians = GaussianMap(max(1, int(kept.sum())))
    gaussians.append(block32[:, kept])
    return gaussians


def splatam_path(path: str | os.PathLike[str]) -> dict[str, np.ndarray] | None:
    """Return poses and camera of a ``params.npz`` as the arrays of a run's ``trajectory.npz``.

    None if the file has no poses.
    """
    content = _read(path)
    needed = ("gt_w2c_all_frames", "intrinsics", "org_width", "org_height", "keyframe_time_indices")
    if any(name not in content for name in needed):
        return None
    poses, matrix, chosen, *sides = (
        _numbers(content, name, path)
        for name in ("gt_w2c_all_frames", "intrinsics", "keyframe_time_indices", "org_width", "org_height")
    )
    keyframes = chosen.astype(np.int64).reshape(-1)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses) or not len(keyframes):
        return None
    if matrix.ndim != 2 or min(matrix.shape) < 3 or any(side.size != 1 for side in sides):
        raise InputError(f"'{path}': expected intrinsics (3, 3), org_width and org_height of one camera")
    if keyframes.min() < 0 or keyframes.max() >= len(poses):
        raise InputError(f"'{path}': keyframe_time_indices point outside the {len(poses)} frames")
    return {
        "world_from_camera": _place(content, path, None) @ poses[0] @ invert_rigid(poses),
        "keyframes": keyframes,
        "intrinsics": np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]),
        "image_size": np.array([int(side.item()) for side in sides]),
    }


def _place(
    content: dict[str, np.ndarray], path: str | os.PathLike[str], given: np.ndarray | None
) -> np.ndarray:  # [4, 4] world from the first camera
    """Return the world pose of the first camera: ``given``, or the pose in the file, or the first true pose.

    If the file has no ground-truth camera poses, or they begin with the identity, return the identity, with a warning.
    Raises `InputError` if the pose is not a rigid transform. ``content`` holds the arrays of the file.
    """
    if given is not None:
        return np.asarray(given, np.float64)
    if _PLACE in content:
        place = _numbers(content, _PLACE, path)
        if place.shape != (4, 4):
            raise InputError(f"'{path}': expected {_PLACE} of shape (4, 4), got {place.shape}")
        return _rigid(place, _PLACE, path)
    poses = _numbers({"gt_w2c_all_frames": np.eye(4)[None], **content}, "gt_w2c_all_frames", path)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
        raise InputError(f"'{path}': expected gt_w2c_all_frames of shape (T, 4, 4), got {poses.shape}")
    if np.allclose(poses[0], np.eye(4), atol=1e-6):
        text = f"'{path}' has no world pose of its first camera; the map stays in the frame of that camera"
        warnings.warn(text, InputWarning, stacklevel=3)
        return np.eye(4)
    return invert_rigid(_rigid(poses[0], "gt_w2c_all_frames[0]", path))


def _numbers(content: Mapping[str, np.ndarray], name: str, path: str | os.PathLike[str]) -> np.ndarray:  # float64
    found = content[name]
    if found.dtype.kind not in "fiu" or not np.isfinite(found).all() or np.abs(found).max(initial=0.0) > _MAX_NUMBER:
        raise InputError(f"'{path}': expected '{name}' as finite numbers up to {_MAX_NUMBER:g}, got {found.dtype}")
    return found.astype(np.float64)


def _rigid(pose: np.ndarray, name: str, path: str | os.PathLike[str]) -> np.ndarray:  # [4, 4]
    turn = pose[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-2 or np.linalg.det(turn) < 0:
        raise InputError(f"'{path}': expected '{name}' to be a rigid motion")
    return pose


def _read(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    try:
        return read_npz(path)
    except FileNotFoundError:
        raise InputError(f"expected a SplaTAM params.npz, but there is no file '{path}'") from None
    except (OSError, ValueError) as error:
        raise InputError(f"'{path}' is not a SplaTAM params.npz ({error})") from error
