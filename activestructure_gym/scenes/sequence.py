"""Posed RGB-D sequences in the layout of NICE-SLAM's Replica download.

``cam_params.json`` (one level up or beside), ``<room>/traj.txt`` (16 numbers per line, row by row: camera to world,
OpenCV axes) and ``<room>/results/frame%06d.jpg`` with ``depth%06d.png`` (uint16; metres = value / scale, 0 = none).
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.sensors.frame import Frame


@dataclass(frozen=True)
class PosedSequence:
    """Recorded frames with their poses; images are read from disk when asked for."""

    camera: PinholeCamera
    world_from_camera: np.ndarray  # [T, 4, 4] float64
    rgb_files: tuple[Path, ...]
    depth_files: tuple[Path, ...]
    depth_scale: float  # depth image value per metre

    def __len__(self) -> int:
        return len(self.rgb_files)

    def frame(self, index: int) -> Frame:
        """Frame ``index`` as a sensor would have returned it. Raises `InputError` for a broken image."""
        import cv2

        rgb_file, depth_file = self.rgb_files[index], self.depth_files[index]
        bgr = cv2.imread(str(rgb_file), cv2.IMREAD_COLOR)
        depth = cv2.imread(str(depth_file), cv2.IMREAD_UNCHANGED)
        for file, image in ((rgb_file, bgr), (depth_file, depth)):
            if image is None:
                raise InputError(f"'{file}' cannot be read as an image")
            if image.shape[:2] != (self.camera.height, self.camera.width):
                raise InputError(
                    f"'{file}' has {image.shape[1]} x {image.shape[0]} pixels, but cam_params.json says "
                    f"{self.camera.width} x {self.camera.height}"
                )
        assert bgr is not None and depth is not None
        if depth.ndim != 2:
            raise InputError(f"'{depth_file}' has {depth.shape[2]} channels; a depth image has one (uint16)")
        return Frame(
            rgb=np.ascontiguousarray(bgr[..., ::-1]),
            depth=(depth.astype(np.float64) / self.depth_scale).astype(np.float32),
            world_from_camera=self.world_from_camera[index],
            camera=self.camera,
        )


def load_sequence(path: str | os.PathLike[str]) -> PosedSequence:
    """The sequence in a folder with ``traj.txt`` and ``results/``; no image is read yet.

    Raises `InputError` where a file is missing, numbers and images do not match, or a pose is no rigid motion.
    """
    path = Path(path).expanduser()
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
        rows = [[float(word) for word in line.split()] for line in file.read_text().splitlines() if line.strip()]
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"'{file}' is not a trajectory of numbers: {error}") from error
    if not rows or any(len(row) != 16 for row in rows):
        raise InputError(f"'{file}' must have 16 numbers per line (a 4 x 4 camera-to-world matrix, row by row)")
    poses = np.array(rows, dtype=np.float64).reshape(-1, 4, 4)
    rigid = np.array([_is_rigid(pose) for pose in poses])
    if not rigid.all():
        line = int(np.argmin(rigid)) + 1
        raise InputError(f"pose {line} of '{file}' is no rigid motion (a rotation and a translation)")
    return poses


def _is_rigid(pose: np.ndarray) -> bool:
    if not np.isfinite(pose).all() or np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6:
        return False
    rotation = pose[:3, :3]
    # 1e-3: trajectories are written with 4 to 18 digits.
    return bool(np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-3 and np.linalg.det(rotation) > 0)


def _numbered(folder: Path, prefix: str) -> tuple[Path, ...]:
    """The images ``<prefix><number>.*`` in the order of their numbers."""
    files = [f for f in folder.glob(f"{prefix}*") if f.suffix.lower() in (".jpg", ".jpeg", ".png")]
    numbers = {f: f.stem.removeprefix(prefix) for f in files}
    return tuple(sorted((f for f in files if numbers[f].isdigit()), key=lambda f: int(numbers[f])))


def _camera(path: Path) -> tuple[PinholeCamera, float]:
    file = next((f for f in (path.parent / "cam_params.json", path / "cam_params.json") if f.is_file()), None)
    if file is None:
        raise InputError(f"sequence '{path}' has no cam_params.json beside its folder ('{path.parent}')")
    try:
        given = json.loads(file.read_text(encoding="utf-8"))["camera"]
        # There pixel centres have integer coordinates, here they lie at + 0.5: the same camera.
        camera = PinholeCamera(
            width=int(given["w"]),
            height=int(given["h"]),
            fx=float(given["fx"]),
            fy=float(given["fy"]),
            cx=float(given["cx"]) + 0.5,
            cy=float(given["cy"]) + 0.5,
        )
        scale = float(given["scale"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"'{file}' must hold camera: w, h, fx, fy, cx, cy, scale; {error!r}") from error
    if not scale > 0:
        raise InputError(f"'{file}': scale (depth image value per metre) must be above 0, got {scale}")
    return camera, scale
