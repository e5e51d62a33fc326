"""Read the camera poses of a COLMAP model, ``images.txt`` or ``images.bin`` ([schoenberger2016], its output format).

COLMAP stores world to camera, as a quaternion w x y z and a translation; the poses are returned as camera to world. The
images of a model are in no order of time, so they are sorted by their names.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.scenes.loaders.pose_text import (
    MAX_COORDINATE_M,
    MAX_POSES,
    number_of,
    poses_of_quaternions,
    refuse_utf16,
)

_MAX_BYTES = 1 << 30  # largest size of a file, 1 GiB; the image points that follow each pose take most of it
_MAX_NAME = 4096  # bytes; longest name of an image
_IMAGE = struct.Struct("<i7di")  # image id, quaternion wxyz, translation, camera id
_POINT_BYTES = 24  # of an image point: x, y, id of the 3D point

_Image = tuple[str, list[float]]  # name, and quaternion wxyz and translation of camera_from_world


def colmap_poses(path: Path) -> np.ndarray:  # [T, 4, 4] world_from_camera
    """Return the poses of an ``images.txt`` or ``images.bin`` in the order of the image names.

    The content shows whether the file is binary. Raise `InputError` for another form.
    """
    try:
        if (size := path.stat().st_size) > _MAX_BYTES:
            raise InputError(f"'{path}' has {size:,} bytes, at most {_MAX_BYTES:,} are read")
        with open(path, "rb") as stream:
            head = stream.read(8)
        refuse_utf16(head, path)
        images = list(_binary(path) if b"\0" in head else _text(path))
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    if not images:
        raise InputError(f"'{path}' is a COLMAP model without images")
    rows = np.array([numbers for _, numbers in sorted(images, key=lambda image: in_number_order(image[0]))])
    if not (np.abs(rows[:, 4:]) <= MAX_COORDINATE_M).all():
        raise InputError(f"'{path}' holds a translation over {MAX_COORDINATE_M:g} m, or one that is not a number")
    xyzw = np.roll(rows[:, :4], -1, axis=1)
    return invert_rigid(poses_of_quaternions(rows[:, 4:], xyzw, path))


def in_number_order(name: str) -> list[tuple[int, str]]:
    """Return a sort key that compares the numbers in names by their values: ``frame_2`` before ``frame_10``."""
    parts = re.split(r"([0-9]{1,18})", name)
    return [(int(part), "") if part.isascii() and part.isdigit() else (-1, part) for part in parts]


def names_image(words: list[str]) -> bool:
    """Return whether the words are a line of an image; lines of image points end in a number."""
    return _is_image_line(words) and math.isnan(number_of(words[-1].split()[-1]))


def _is_image_line(words: list[str]) -> bool:
    """Return whether the words can be a line of an image: id, quaternion, translation, camera id and a name."""
    try:
        int(words[0]), int(words[8]), [float(word) for word in words[1:8]]
    except (ValueError, IndexError):
        return False
    return len(words) > 9


def _text(path: Path) -> Iterator[_Image]:
    """Read ``images.txt``: two lines per image, of which the second one (image points) may be empty."""
    with open(path, encoding="utf-8-sig", errors="replace") as stream:
        lines = (line for line in stream if not line.lstrip().startswith("#"))
        for count, line in enumerate(line for line in lines if line.strip()):
            words = line.split(maxsplit=9)
            if not _is_image_line(words):
                raise InputError(
                    f"'{path}' is not a COLMAP images.txt: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME and a "
                    f"line of image points for each image, got {short_repr(' '.join(words)[:80])}"
                )
            if count == MAX_POSES:
                raise InputError(f"'{path}' holds more than {MAX_POSES} poses")
            yield words[9].strip(), [float(word) for word in words[1:8]]
            if names_image(next(lines, "").split(maxsplit=9)):
                raise InputError(
                    f"'{path}' has no line of image points after the image {short_repr(words[9].strip())}: expected "
                    "two lines for each image, of which the second one can be empty"
                )


def _binary(path: Path) -> Iterator[_Image]:
    with open(path, "rb") as stream:
        size = path.stat().st_size
        (count,) = struct.unpack("<Q", stream.read(8).ljust(8, b"\0"))
        if count > MAX_POSES or count * _IMAGE.size > size:
            raise InputError(f"'{path}' is not a COLMAP images.bin: {count:,} images do not fit in its {size:,} bytes")
        for number in range(1, count + 1):
            head = stream.read(_IMAGE.size)
            begin = stream.tell()
            name, end, _ = stream.read(_MAX_NAME).partition(b"\0")
            stream.seek(begin + len(name) + 1)
            points = stream.read(8)
            if not end or len(points) < 8:
                raise InputError(
                    f"'{path}' is cut off or no images.bin of COLMAP: it ends in image {number} of {count}"
                )
            position = stream.tell() + struct.unpack("<Q", points)[0] * _POINT_BYTES
            if position > size:
                raise InputError(f"'{path}' is cut off: it ends in the points of image {number} of {count}")
            stream.seek(position)
            yield name.decode("utf-8", errors="replace"), list(_IMAGE.unpack(head)[1:8])
        if stream.read(1):
            raise InputError(f"'{path}' is not a COLMAP images.bin: data follow its {count} images")
