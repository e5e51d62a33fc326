"""Read camera poses from text files with one pose per line, or one matrix per five lines (Redwood)."""

from __future__ import annotations

import math
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import unrounded

MAX_POSES = 200_000  # largest number of poses in a file
_MAX_BYTES = 64 << 20  # largest size of a text file, 64 MiB
_RIGID = 1e-3  # largest accepted entry of |R R^T - I|, since some files have only 4 digits
MAX_COORDINATE_M = 1e6  # metres; a larger coordinate is an error


def text_of(path: Path) -> str:
    """Return the content of a text file; raise `InputError` if it cannot be read, is too large, or is no text."""
    try:
        size = path.stat().st_size
        if size > _MAX_BYTES:
            raise InputError(f"'{path}' has {size:,} bytes, at most {_MAX_BYTES:,} are read")
        content = path.read_bytes()
        refuse_utf16(content, path)
        return content.decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"'{path}' is not text; expected lines of numbers") from error


def refuse_utf16(content: bytes, path: Path) -> None:
    """Raise `InputError` if the first bytes of a file are the byte order mark of UTF-16.

    A COLMAP model of 65,279 images begins like such text, but four zero bytes follow.
    """
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) and content[4:8] != bytes(4):
        raise InputError(f"'{path}' is UTF-16 text: save it as UTF-8")


def number_of(word: str) -> float:
    """Return a word as a number, or NaN."""
    try:
        return float(word)
    except ValueError:
        return math.nan


def lines_of(path: Path, *, most: int | None = None) -> list[tuple[int, list[str]]]:
    """Return the line number and the words of each line of a text file, without empty lines and comments.

    Words are separated by blanks or commas. At most ``most`` lines are returned, by default `MAX_POSES` + 1, which is
    enough to detect files that are too long.
    """
    words = ((n, line.replace(",", " ").split()) for n, line in enumerate(text_of(path).splitlines(), start=1))
    lines = ((number, line) for number, line in words if line and not line[0].startswith("#"))
    return list(islice(lines, MAX_POSES + 1 if most is None else most))


def numbers_of(path: Path) -> np.ndarray:  # [T, width]
    """Return the numbers of a text file; raise `InputError` if there are none or the lines differ in length."""
    lines = lines_of(path)
    if not lines:
        raise InputError(f"'{path}' holds no pose")
    width = len(lines[0][1])
    for number, words in lines:
        if len(words) != width:
            raise InputError(f"line {number} of '{path}' has {len(words)} numbers, and the first one has {width}")
    try:
        rows = np.array([words for _, words in lines], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"'{path}' has a value that is not a number: {' '.join(str(error).split())[:200]}") from error
    return rows


def redwood_poses(path: Path) -> np.ndarray:  # [T, 4, 4]
    """Return the matrices of a Redwood ``.log`` file: a line of three numbers, then four rows of four, for each pose.

    Raise `InputError` for another form.
    """
    lines = [words for _, words in lines_of(path, most=5 * MAX_POSES + 1)]
    if not lines or len(lines) % 5 or any(len(words) != (4 if n % 5 else 3) for n, words in enumerate(lines)):
        raise InputError(
            f"'{path}' is not a Redwood trajectory: expected a line of 3 numbers and 4 lines of 4 numbers per pose"
        )
    try:
        return np.array([words for n, words in enumerate(lines) if n % 5], dtype=np.float64).reshape(-1, 4, 4)
    except ValueError as error:
        raise InputError(f"'{path}' has a value that is not a number: {' '.join(str(error).split())[:200]}") from error


def tum_poses(
    rows: np.ndarray,  # [T, 8]: time stamp in seconds, position in metres, quaternion xyzw
    path: Path,
) -> np.ndarray:  # [T, 4, 4]
    """Return the poses of a TUM file; raise `InputError` for a wrong quaternion or time stamp."""
    poses = poses_of_quaternions(rows[:, 1:4], rows[:, 4:], path)
    if (unsorted := ~(np.diff(rows[:, 0]) >= 0)).any():
        raise InputError(
            f"pose {int(np.argmax(unsorted)) + 2} of '{path}' has an earlier time stamp than the one before, or none: "
            "sort the lines"
        )
    if not np.isfinite(rows[:, 0]).all():
        raise InputError(f"a time stamp of '{path}' is not a finite number")
    return poses


def matrices_of(rows: np.ndarray) -> np.ndarray:  # [T, 12 or 16] -> [T, 4, 4]
    """Return the matrices that are given row by row, with or without the last row."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses.reshape(len(rows), 16)[:, : rows.shape[1]] = rows
    return poses


def poses_of_quaternions(
    positions: np.ndarray,  # [T, 3] metres
    xyzw: np.ndarray,  # [T, 4]
    path: Path,
) -> np.ndarray:  # [T, 4, 4]
    """Return the poses; raise `InputError` if the length of a quaternion differs from 1 by more than 0.01."""
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(xyzw, axis=1)
    wrong = ~(np.abs(lengths - 1.0) <= 1e-2)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(f"pose {at + 1} of '{path}' has a quaternion of length {lengths[at]:.3g}, expected 1")
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(xyzw).as_matrix()
    poses[:, :3, 3] = positions
    return poses


def rigid_poses(poses: np.ndarray, path: Path) -> np.ndarray:  # [T, 4, 4]
    """Return the poses with exact rotations; raise `InputError` unless each is a rigid motion in metres."""
    finite = np.isfinite(poses).all(axis=(1, 2))
    kept = np.where(finite[:, None, None], poses, 0.0)
    far = np.abs(kept[:, :3, 3]).max(axis=1)
    if (far > MAX_COORDINATE_M).any():
        at = int(np.argmax(far > MAX_COORDINATE_M))
        raise InputError(f"pose {at + 1} of '{path}' is {far[at]:g} m away from the origin: metres are expected")
    kept = np.clip(kept, -MAX_COORDINATE_M, MAX_COORDINATE_M)
    rotations = kept[:, :3, :3]
    straight = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) <= _RIGID
    straight &= np.abs(kept[:, 3] - [0, 0, 0, 1]).max(axis=1) <= _RIGID
    mirrored = straight & (np.linalg.det(rotations) < 0)
    if mirrored.any():
        raise InputError(
            f"pose {int(np.argmax(mirrored)) + 1} of '{path}' mirrors: its axes are left-handed; a right-handed "
            "convention is needed (invert one axis)"
        )
    if not straight.all():
        raise InputError(
            f"pose {int(np.argmin(straight)) + 1} of '{path}' is not a rigid motion (rotation, translation)"
        )
    return unrounded(poses)
