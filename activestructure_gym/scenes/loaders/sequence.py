"""Read posed RGB-D sequences; camera to world, OpenCV axes. Depth is uint16: metres = value / scale, 0 = none.

- NICE-SLAM's Replica download ([nice_slam, code]): ``cam_params.json`` (in the folder or one level up), ``traj.txt``
  (16 numbers per line, row by row), ``results/frame%06d.jpg`` and ``results/depth%06d.png``.
- Redwood and Open3D ([choi2015]): ``trajectory.log``, ``color/%05d.jpg`` (or ``image/``, ``rgb/``), ``depth/%05d.png``.
- TUM RGB-D ([tum_rgbd]): ``groundtruth.txt``, ``rgb.txt`` and ``depth.txt``, or ``associations.txt``.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.scenes.loaders.budget import LimitError, SceneBudget
from activestructure_gym.scenes.loaders.images import opened_image
from activestructure_gym.scenes.loaders.json_files import read_json
from activestructure_gym.scenes.loaders.pose_text import (
    lines_of,
    matrices_of,
    numbers_of,
    redwood_poses,
    rigid_poses,
    tum_poses,
)

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PIXELS = 1 << 23  # maximum pixels of a frame (4K video); evaluations hold dozens of frames in memory
_MAX_APART_S = 0.02  # seconds; largest difference of the time stamps of one TUM frame
_PRIMESENSE = (525.0, 525.0, 319.5, 239.5)  # default intrinsics of Redwood's and TUM's sequences of 640 x 480 pixels
_DEPTH_MODES = ("I;16", "I;16B", "I", "L")  # Pillow modes of single-channel integer images


@dataclass(frozen=True)
class PosedSequence:
    """Hold recorded frames with their poses; images are read from disk on demand."""

    camera: PinholeCamera
    world_from_camera: np.ndarray  # [T, 4, 4] float64
    rgb_files: tuple[Path, ...]
    depth_files: tuple[Path, ...]
    depth_scale: float  # depth image value per metre

    def __len__(self) -> int:
        return len(self.rgb_files)

    def frame(self, index: int) -> Frame:
        """Return frame ``index`` in the form of a sensor's frame. Raises `InputError` for a damaged image."""
        rgb = self._image(self.rgb_files[index]).convert("RGB")
        depth_file = self.depth_files[index]
        depth = self._image(depth_file)
        if depth.mode not in _DEPTH_MODES:
            raise InputError(f"'{depth_file}' is a {depth.mode} image; a depth image has one channel (uint16)")
        return Frame(
            rgb=np.array(rgb),
            depth=(np.asarray(depth, dtype=np.float64) / self.depth_scale).astype(np.float32),
            world_from_camera=self.world_from_camera[index],
            camera=self.camera,
        )

    def _image(self, file: Path) -> Image:
        image = _opened(file)
        if image.size != (self.camera.width, self.camera.height):
            raise InputError(
                f"'{file}' has {image.width} x {image.height} pixels, but the sequence's camera has "
                f"{self.camera.width} x {self.camera.height}"
            )
        try:
            image.load()
        except Exception as error:  # Pillow raises any error of the codec
            raise InputError(f"'{file}' cannot be read as an image") from error
        return image


def _opened(file: Path) -> Image:
    """Return an image that is not yet decoded; raise `InputError` if it cannot be read."""
    try:
        return opened_image(SceneBudget().read(file), formats=("JPEG", "PNG"), most_pixels=MAX_PIXELS)
    except InputError:
        raise
    except Exception as error:  # Pillow raises any error of its formats
        reason = f": it {error}" if isinstance(error, LimitError) else ""
        raise InputError(f"'{file}' cannot be read as an image{reason}") from error


def load_sequence(
    path: str | os.PathLike[str],
    *,
    intrinsics: Sequence[float] | None = None,
    depth_scale: float | None = None,
) -> PosedSequence:
    """Load a recorded sequence from its folder, without reading images. The layout follows from the files in it.

    Parameters
    ----------
    path
        The folder.
    intrinsics
        Focal lengths and principal point fx, fy, cx, cy in pixels, with pixel centres at integers, as data sets state
        them. Default: the folder's camera file; for Redwood and TUM without one 525, 525, 319.5, 239.5.
    depth_scale
        Depth image value per metre. Default: that of ``cam_params.json``, 1000 for Redwood, 5000 for TUM.

    Raises
    ------
    InputError
        If a file is missing, the numbers of poses and images differ, or a pose is not rigid.
    """
    path = Path(os.path.abspath(os.path.expanduser(path)))
    if not path.is_dir():
        raise InputError(f"there is no sequence folder '{path}'")
    if depth_scale is not None and not (depth_scale > 0 and np.isfinite(depth_scale)):
        raise InputError(f"depth_scale is the depth image value per metre, above 0, got {depth_scale}")
    layouts = {"trajectory.log": _redwood, "groundtruth.txt": _tum}
    layout = next((read for name, read in layouts.items() if (path / name).is_file()), None)
    if layout is None:
        found = _nice_slam(path)
        camera = (
            found.camera if intrinsics is None else _given_camera(intrinsics, found.camera.width, found.camera.height)
        )
        return replace(found, camera=camera, depth_scale=depth_scale or found.depth_scale)
    poses, rgb_files, depth_files, usual_scale = layout(path)
    camera = _camera_beside(path, rgb_files[0], intrinsics)
    return PosedSequence(camera, poses, rgb_files, depth_files, depth_scale or usual_scale)


def _nice_slam(path: Path) -> PosedSequence:
    file = path / "traj.txt"
    if not file.is_file():
        raise InputError(
            f"there is no trajectory '{file}' (16 numbers per line, camera to world), nor trajectory.log (Redwood) or "
            "groundtruth.txt (TUM) in that folder"
        )
    rows = numbers_of(file)
    if rows.shape[1] != 16:
        raise InputError(f"'{file}' must have 16 numbers per line (a 4 x 4 camera-to-world matrix, row by row)")
    poses = rigid_poses(matrices_of(rows), file)
    rgb_files, depth_files = _numbered(path / "results", "frame"), _numbered(path / "results", "depth")
    _check_numbers(path, poses, rgb_files, depth_files)
    camera, depth_scale = _camera(path)
    return PosedSequence(camera, poses, rgb_files, depth_files, depth_scale)


_Layout = tuple[np.ndarray, tuple[Path, ...], tuple[Path, ...], float]  # poses, colour, depth, depth value per metre


def _redwood(path: Path) -> _Layout:
    file = path / "trajectory.log"
    poses = rigid_poses(redwood_poses(file), file)
    folder = next((path / name for name in ("color", "image", "rgb") if (path / name).is_dir()), path / "color")
    rgb_files, depth_files = _numbered(folder, ""), _numbered(path / "depth", "")
    _check_numbers(path, poses, rgb_files, depth_files)
    return poses, rgb_files, depth_files, 1000.0


def _tum(path: Path) -> _Layout:
    """Return the frames whose colour image has a depth image and a pose at most 0.02 s away ([tum_rgbd], its tools)."""
    file = path / "groundtruth.txt"
    rows = numbers_of(file)
    if rows.shape[1] != 8:
        raise InputError(f"'{file}' must have 8 numbers per line (timestamp tx ty tz qx qy qz qw), got {rows.shape[1]}")
    poses = rigid_poses(tum_poses(rows, file), file)
    pairs = path / "associations.txt"
    if pairs.is_file():
        colour, depth = _listed(pairs, 0), _listed(pairs, 2)
        depth_at = np.arange(len(colour[0]))
    else:
        colour, depth = _listed(path / "rgb.txt", 0), _listed(path / "depth.txt", 0)
        depth_at = _nearest(colour[0], depth[0])
    pose_at = _nearest(colour[0], rows[:, 0])
    kept = np.flatnonzero((depth_at >= 0) & (pose_at >= 0))
    if not len(kept):
        raise InputError(
            f"no colour image of '{path}' has a depth image and a pose within {_MAX_APART_S} s: check the time stamps"
        )
    rgb_files, depth_files = (tuple(colour[1][n] for n in kept), tuple(depth[1][n] for n in depth_at[kept]))
    missing = [one for one in (*rgb_files, *depth_files) if not _is_below(one, path)]
    if missing:
        raise InputError(
            f"'{path}' lists {len(missing)} images that are not in that folder, the first is "
            f"{short_repr(os.path.relpath(missing[0], path))}"
        )
    return poses[pose_at[kept]], rgb_files, depth_files, 5000.0


def _is_below(file: Path, folder: Path) -> bool:
    """Return whether an image is a file in the folder or below it; foreign lists must not read elsewhere."""
    below = os.path.abspath(file).startswith(os.path.join(os.path.abspath(folder), ""))
    return below and os.path.isfile(file)


def _listed(file: Path, column: int) -> tuple[np.ndarray, list[Path]]:
    """Return the time stamps [n] (seconds) in a column of a TUM list, and the files in the next column."""
    if not file.is_file():
        raise InputError(f"there is no '{file.name}' in '{file.parent}' (a time stamp and a file per line)")
    lines = [words for _, words in lines_of(file)]
    try:
        return np.array([float(words[column]) for words in lines]), [file.parent / w[column + 1] for w in lines]
    except (ValueError, IndexError):
        raise InputError(f"'{file}' must have a time stamp and a file per line") from None


def _nearest(stamps: np.ndarray, others: np.ndarray) -> np.ndarray:  # [n], [m] seconds -> [n] index, -1 = none
    """Return the index in ``others`` of the time stamp nearest to each of ``stamps``; -1 if it is over 0.02 s away."""
    if not len(others):
        return np.full(len(stamps), -1)
    order = np.argsort(others, kind="stable")
    after = np.clip(np.searchsorted(others[order], stamps), 1, max(1, len(others) - 1))
    sides = order[np.stack([after - 1, np.minimum(after, len(others) - 1)])]
    apart = np.abs(others[sides] - stamps)
    nearest = np.where(apart[0] <= apart[1], sides[0], sides[1])
    return np.where(apart.min(axis=0) <= _MAX_APART_S, nearest, -1)


def _check_numbers(path: Path, poses: np.ndarray, rgb: tuple[Path, ...], depth: tuple[Path, ...]) -> None:
    if not len(poses) == len(rgb) == len(depth):
        raise InputError(
            f"sequence '{path}' has {len(poses)} poses, {len(rgb)} colour and {len(depth)} depth images; the three "
            "numbers must be equal"
        )
    for one, other in zip(rgb, depth):
        if _number_of(one) != _number_of(other):
            raise InputError(
                f"sequence '{path}': the colour image '{one.name}' and the depth image '{other.name}' would be one "
                "frame, but their numbers differ: an image is missing on each side"
            )


def _camera_beside(path: Path, image: Path, intrinsics: Sequence[float] | None) -> PinholeCamera:
    """Return the camera of a Redwood or TUM sequence.

    The intrinsics are the given ones, else those of a ``camera*.json`` in Open3D's form, else the defaults of both data
    sets. ``image`` is one of the images, which has the size of the camera.
    """
    width, height = _opened(image).size
    file = next(iter(sorted(path.glob("camera*.json"))), None)
    if intrinsics is None and file is not None:
        wanted = "a camera of Open3D (width, height, intrinsic_matrix)"
        matrix, width, height = read_json(
            file,
            wanted,
            lambda k: (np.array(k["intrinsic_matrix"], float).reshape(3, 3), int(k["width"]), int(k["height"])),
        )
        if matrix[0, 2] and not matrix[2, :2].any():
            raise InputError(f"'{file}': Open3D writes the intrinsic_matrix by columns, and this one is by rows")
        intrinsics = matrix[0, 0], matrix[1, 1], matrix[2, 0], matrix[2, 1]
    elif intrinsics is None and (width, height) != (640, 480):
        raise InputError(
            f"'{path}' has no camera*.json, and its images are {width} x {height}: give intrinsics=fx,fy,cx,cy"
        )
    return _given_camera(intrinsics or _PRIMESENSE, width, height)


def _given_camera(intrinsics: Sequence[float], width: int, height: int) -> PinholeCamera:
    if len(intrinsics) != 4 or not np.isfinite(intrinsics).all() or not (intrinsics[0] > 0 and intrinsics[1] > 0):
        raise InputError(f"intrinsics are fx, fy, cx, cy in pixels, with fx and fy above 0, got {tuple(intrinsics)}")
    fx, fy, cx, cy = map(float, intrinsics)
    if width < 1 or height < 1:
        raise InputError(f"an image needs at least one pixel, and the camera file has {width} x {height}")
    # The data sets put pixel centres at integers, this project at + 0.5.
    return PinholeCamera(width, height, fx, fy, cx + 0.5, cy + 0.5)


def _numbered(folder: Path, prefix: str) -> tuple[Path, ...]:
    """Return the images ``<prefix><number>.*`` sorted by number."""
    files = [f for f in folder.glob(f"{prefix}*") if f.suffix.lower() in (".jpg", ".jpeg", ".png")]
    return tuple(sorted((f for f in files if f.stem.removeprefix(prefix).isdecimal()), key=_number_of))


def _number_of(file: Path) -> int:
    return int(file.stem.lstrip("abcdefghijklmnopqrstuvwxyz"))


def _camera(path: Path) -> tuple[PinholeCamera, float]:
    file = next((f for f in (path / "cam_params.json", path.parent / "cam_params.json") if f.is_file()), None)
    if file is None:
        raise InputError(f"sequence '{path}' has no cam_params.json in its folder, or in '{path.parent}'")
    camera, scale = read_json(file, "a camera (camera: w, h, fx, fy, cx, cy, scale)", _parsed_camera)
    if camera.width * camera.height > MAX_PIXELS:
        raise InputError(
            f"'{file}': frames of {camera.width} x {camera.height} pixels are too large (at most {MAX_PIXELS:,} "
            "pixels are read); shrink them"
        )
    if not (scale > 0 and np.isfinite(scale)):
        raise InputError(f"'{file}': scale (depth image value per metre) must be above 0, got {scale}")
    return camera, scale


def _parsed_camera(given: Any) -> tuple[PinholeCamera, float]:
    given = given["camera"]
    # Pixel centres are at integers in the file, and at integers + 0.5 in this project.
    camera = PinholeCamera(
        width=int(given["w"]),
        height=int(given["h"]),
        fx=float(given["fx"]),
        fy=float(given["fy"]),
        cx=float(given["cx"]) + 0.5,
        cy=float(given["cy"]) + 0.5,
    )
    if not np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all():
        raise ValueError("its numbers must be finite")
    return camera, float(given["scale"])
