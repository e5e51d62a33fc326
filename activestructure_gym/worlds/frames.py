"""Bring the images of a world to the form that mapping needs: one size, metres, and which pixels were measured."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame, warn_of_millimetres
from activestructure_gym.worlds.base import checked_pose

_SAME_ASPECT = 0.02  # largest relative difference of width / height between an image and the camera
_ROUNDING = 1e-3  # by which floating-point colours may be outside 0..1; a step of uint8 is 0.004


def frame_from(
    rgb: Any,  # [H, W, 3] uint8, or float in 0..1
    depth: Any,  # [H, W] or [H, W, 1] metres
    world_from_camera: Any,  # [4, 4]
    camera: PinholeCamera,
    max_range: float = np.inf,  # metres; worlds leave it out, since an episode applies its sensor's
) -> Frame:
    """Return a frame of ``camera``; raise `InputError` for arrays that are no colour image, depth image or pose.

    - The arrays are copied, since cameras can reuse them.
    - Depth of 0, below 0 or NaN becomes 0 and is marked in `Frame.unmeasured`: it proves nothing.
    - Depth beyond ``max_range`` becomes 0: no surface is within that range. Without a range, infinite depth stays.
    - An `InputWarning` is given if the depth seems to be in millimetres.
    - Images of another size are resized to the camera's: colour by area, depth by the nearest pixel. Their aspect ratio
      must be the camera's.
    """
    colour = np.asarray(rgb)
    if colour.ndim != 3 or colour.shape[2] not in (3, 4):
        raise InputError(f"a colour image is an array [H, W, 3], got {_described(rgb)}")
    colour = colour[..., :3]
    if colour.dtype.kind == "f":
        if not ((colour >= -_ROUNDING) & (colour <= 1.0 + _ROUNDING)).all():
            raise InputError("a colour image of floating-point numbers has values from 0 to 1; give uint8 for 0 to 255")
        colour = np.rint(255.0 * np.clip(colour, 0.0, 1.0)).astype(np.uint8)
    elif colour.dtype != np.uint8:
        raise InputError(f"a colour image has dtype uint8, or floating-point numbers from 0 to 1, got {colour.dtype}")

    metres = np.asarray(depth)
    metres = metres[..., 0] if metres.ndim == 3 and metres.shape[2] == 1 else metres
    if metres.ndim != 2:
        raise InputError(f"a depth image is an array [H, W], got {_described(depth)}")
    if metres.dtype.kind != "f":
        raise InputError(
            f"depth is in metres as floating-point numbers, got {metres.dtype}; divide millimetres by 1000.0"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        metres = metres.astype(np.float32)
    warn_of_millimetres(metres, stacklevel=2)
    size = (camera.width, camera.height)
    metres = _resized("depth", metres, size, cv2.INTER_NEAREST_EXACT)
    with np.errstate(invalid="ignore"):
        unmeasured, within = ~(metres > 0.0), metres <= np.float32(max_range)
    return Frame(
        rgb=np.array(_resized("colour", colour, size, cv2.INTER_AREA), order="C"),
        depth=np.ascontiguousarray(np.where(unmeasured | ~within, np.float32(0.0), metres)),
        world_from_camera=checked_pose("the pose of a frame", world_from_camera),
        camera=camera,
        unmeasured=unmeasured if unmeasured.any() else None,
    )


def _resized(kind: str, image: np.ndarray, size: tuple[int, int], interpolation: int) -> np.ndarray:
    """Return an image with ``size`` (width, height); raise `InputError` if its aspect ratio differs."""
    height, width = image.shape[:2]
    if (width, height) == size:
        return image
    if not min(width, height) or abs(width * size[1] / (height * size[0]) - 1.0) > _SAME_ASPECT:
        raise InputError(
            f"a {kind} image of {width} x {height} pixels does not fit the camera of {size[0]} x {size[1]}: their "
            "aspect ratios differ; crop it, or give the camera of this image"
        )
    return np.asarray(cv2.resize(image, size, interpolation=interpolation))


def _described(value: Any) -> str:
    shape = getattr(value, "shape", None)
    return f"shape {tuple(shape)}" if shape is not None else short_repr(value)
