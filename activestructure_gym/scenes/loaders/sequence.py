"""Read posed RGB-D sequences in the layout of NICE-SLAM's Replica download ([nice_slam, code]).

Files: ``cam_params.json`` (in the folder or one level up), ``<room>/traj.txt`` (16 numbers per line, row by row: camera
to world, OpenCV axes), ``<room>/results/frame%06d.jpg`` and ``depth%06d.png`` (uint16; metres = value / scale, 0 =
none).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, unrounded
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.scenes.loaders.budget import LimitError, SceneBudget
from activestructure_gym.scenes.loaders.images import opened_image
from activestructure_gym.scenes.loaders.json_files import read_json

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PIXELS = 1 << 23  # maximum pixels of a frame (4K video); evaluations hold dozens of frames in memory
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
        try:
            image = opened_image(SceneBudget().read(file), formats=("JPEG", "PNG"), most_pixels=MAX_PIXELS)
            if image.size != (self.camera.width, self.camera.height):
                raise InputError(
                    f"'{file}' has {image.width} x {image.height} pixels, but cam_params.json says "
                    f"{self.camera.width} x {self.camera.height}"
                )
            image.load()
        except InputError:
            raise
        except Exception as error:  # Pillow raises any error of the codec
            reason = f": it {error}" if isinstance(error, LimitError) else ""
            raise InputError(f"'{file}' cannot be read as an image{reason}") from error
        return image


def load_sequence(path: str | os.PathLike[str]) -> PosedSequence:
    """Load the sequence in a folder with ``traj.txt`` and ``results/``, without reading images.

    Raises `InputError` if a file is missing, numbers and images do not match, or a pose is not rigid.
    """
    path = Path(os.path.expanduser(path))
    if not path.is_dir():
        raise InputError(f"there is no sequence folder '{path}'")
    poses = _poses(path / "traj.txt")
    rgb_files = _numbered(path / "results", "frame")
    depth_files = _numbered(path / "results", "depth")
    if not len(poses) == len(rgb_files) == len(depth_files):
        raise InputError(
            f"sequence '{path}' has {len(poses)} poses, {len(rgb_files)} colour and {len(depth_files)} depth images; "
            "the three numbers must be equal"
        )
    camera, depth_scale = _camera(path)
    return PosedSequence(camera, poses, rgb_files, depth_files, depth_scale)


def _poses(file: Path) -> np.ndarray:  # [T, 4, 4]
    if not file.is_file():
        raise InputError(f"there is no trajectory '{file}' (16 numbers per line, camera to world)")
    try:
        text = SceneBudget().read(file).decode("utf-8-sig")
        rows = [[float(word) for word in line.split()] for line in text.splitlines() if line.strip()]
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"'{file}' is not a trajectory of numbers: {reason}") from error
    if not rows or any(len(row) != 16 for row in rows):
        raise InputError(f"'{file}' must have 16 numbers per line (a 4 x 4 camera-to-world matrix, row by row)")
    poses = np.array(rows, dtype=np.float64).reshape(-1, 4, 4)
    rigid = _is_rigid(poses)
    if not rigid.all():
        line = int(np.argmin(rigid)) + 1
        raise InputError(f"pose {line} of '{file}' is no rigid motion (a rotation and a translation)")
    return unrounded(poses)


def _is_rigid(poses: np.ndarray) -> np.ndarray:  # [T, 4, 4] -> [T] bool
    finite = np.isfinite(poses).all(axis=(1, 2))
    # Poses with values above 1e6 (metres) are replaced by zeros, which are no rigid motion.
    poses = np.where(finite[:, None, None] & (np.abs(poses) < 1e6), poses, 0.0)
    rotation = poses[:, :3, :3]
    # The tolerance is 1e-3, since trajectories are written with 4 to 18 digits.
    orthogonal = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) <= 1e-3
    return orthogonal & (np.linalg.det(rotation) > 0) & (np.abs(poses[:, 3] - [0, 0, 0, 1]).max(axis=1) <= 1e-6)


def _numbered(folder: Path, prefix: str) -> tuple[Path, ...]:
    """Return the images ``<prefix><number>.*`` sorted by number."""
    files = [f for f in folder.glob(f"{prefix}*") if f.suffix.lower() in (".jpg", ".jpeg", ".png")]
    numbers = {f: f.stem.removeprefix(prefix) for f in files}
    return tuple(sorted((f for f in files if numbers[f].isdecimal()), key=lambda f: int(numbers[f])))


def _camera(path: Path) -> tuple[PinholeCamera, float]:
    file = next((f for f in (path.parent / "cam_params.json", path / "cam_params.json") if f.is_file()), None)
    if file is None:
        raise InputError(f"sequence '{path}' has no cam_params.json next to its folder ('{path.parent}')")
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
