"""A small RGB-D recording, rendered by our own sensor into a folder in Redwood's layout."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from activestructure_gym.geometry import look_along
from activestructure_gym.scenes import load_scene
from activestructure_gym.sensors import RGBDSensor, SensorConfig

COUNT = 24
# World axes of a first camera held level: x right, y down, z ahead.
FIRST_FROM_WORLD = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def recorded_poses() -> np.ndarray:  # [24, 4, 4], z up
    """A hand-held turn on a circle of radius 0.4 m in the box, with up to 6 degrees of roll and some pitch."""
    poses = []
    for n in range(COUNT):
        yaw = 2 * np.pi * n / COUNT
        away = np.array([np.cos(yaw), np.sin(yaw), 0.15 * np.sin(3 * yaw)])
        pose = look_along(np.array([2.0, 1.5, 1.2]) + 0.4 * away, away)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("z", 6.0 * np.sin(2 * yaw), degrees=True).as_matrix()
        poses.append(pose)
    return np.stack(poses)


def log_text(poses: np.ndarray) -> str:
    rows = ["\n".join(" ".join(map(repr, map(float, row))) for row in pose) for pose in poses]
    return "".join(f"{n} {n} {n + 1}\n{row}\n" for n, row in enumerate(rows))


def record(folder: Path, poses: np.ndarray) -> Path:
    """Write a sequence in Redwood's layout, in the axes of a level first camera."""
    sensor = RGBDSensor(load_scene("box"), SensorConfig(width=64, height=48, supersample=1), np.random.default_rng(0))
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for n, pose in enumerate(poses):
        frame = sensor.capture(pose)
        cv2.imwrite(str(folder / "color" / f"{n:05d}.png"), frame.rgb[..., ::-1])
        cv2.imwrite(str(folder / "depth" / f"{n:05d}.png"), np.rint(1000 * frame.depth).astype(np.uint16))
    turned = poses.copy()
    turned[:, :3] = FIRST_FROM_WORLD @ poses[:, :3]
    (folder / "trajectory.log").write_text(log_text(turned))
    lens = sensor.camera
    (folder / "camera.json").write_text(
        f'{{"width": 64, "height": 48, "intrinsic_matrix": '
        f"[{lens.fx}, 0, 0, 0, {lens.fy}, 0, {lens.cx - 0.5}, {lens.cy - 0.5}, 1]}}"
    )
    return folder
