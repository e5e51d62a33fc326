"""Draw the images of a film of one or two recorded runs: growing maps with large names, and a curve below each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from PIL import Image

from activestructure_gym.evaluation.replay.page import names_of
from activestructure_gym.evaluation.replay.recording import Recording
from activestructure_gym.evaluation.report.pictures.canvas import text_width, write
from activestructure_gym.evaluation.report.style import FAINT_INK, HAIR, INK, PAPER, colour
from activestructure_gym.geometry.camera import PinholeCamera
from activestructure_gym.mapping.gaussian_map import MEAN
from activestructure_gym.splatting import render

IMAGES_PER_SECOND = 12
PLAYED_S, STILL_S = 4.5, 1.5  # seconds during which the maps grow, and during which the last image is shown

WIDTH = 600  # of a run's column, pixels
NAME_HEIGHT, MAP_HEIGHT, CURVE_HEIGHT, MARGIN = 66, 430, 190, 14  # pixels
LARGE, SMALL = 42, 30  # font sizes in pixels
PATH = (224, 33, 138)  # colour of the camera and its path, as on the replay page
_CUT = 0.86  # share of the workspace's height above which nothing is drawn, so that the ceiling is open
_YAW, _PITCH, _DISTANCE, _FOCAL = 0.94, 0.95, 1.25, 1.1  # of the replay page's initial view; yaw plus quarter turns
# Metric of the curve: the first one that all runs have. Each has its name on the page and its unit.
_MEASURES = (("observed", "observed surface", "%"), ("known_m3", "known space", "m³"))


def film_images(recordings: Sequence[Recording]) -> Iterator[np.ndarray]:
    """Yield the images of the film up to the last one, each [H, W, 3] uint8.

    A column per run has the run's name, its map seen from outside and without ceiling, and one curve. The maps grow
    over `PLAYED_S` seconds. The last image shows the end of the episode.
    """
    _, names = names_of([one.run for one in recordings])
    end = max(one.moments[-1].frame for one in recordings)
    curves = _curves(recordings)
    start = recordings[0].poses[0, :3, 3]  # all maps are seen from one side
    columns = [_Column(one, name, number, start) for number, (one, name) in enumerate(zip(recordings, names))]
    for share in np.linspace(0.0, 1.0, round(PLAYED_S * IMAGES_PER_SECOND)):
        frame = round(1 + share * (end - 1))
        page = Image.new("RGB", (WIDTH * len(columns), NAME_HEIGHT + MAP_HEIGHT + CURVE_HEIGHT * bool(curves)), PAPER)
        for column in columns:
            left = WIDTH * column.number
            write(page, (left + MARGIN, 8), column.name, size=column.size, bold=True, fill=column.tint)
            page.paste(Image.fromarray(column.map_at(frame)), (left, NAME_HEIGHT))
            if curves:
                chart = _chart(curves[column.number], curves, frame, end, column.tint)
                page.paste(chart, (left, NAME_HEIGHT + MAP_HEIGHT))
        yield np.asarray(page)


class _Column:
    """Draw the map of one run."""

    def __init__(self, recording: Recording, name: str, number: int, start: np.ndarray) -> None:
        self.recording, self.name, self.number = recording, name, number
        self.tint = _rgb(colour(number))
        # A name that is too long for its column gets a smaller font.
        self.size = min(LARGE, int(LARGE * (WIDTH - 2 * MARGIN) / text_width(name, LARGE, bold=True)))
        self.camera = PinholeCamera(
            WIDTH, MAP_HEIGHT, _FOCAL * MAP_HEIGHT, _FOCAL * MAP_HEIGHT, WIDTH / 2, MAP_HEIGHT / 2
        )
        low, high = recording.bounds
        self.pose = outside_pose(recording.bounds, start, WIDTH / MAP_HEIGHT)
        below = recording.gaussians[MEAN][2] <= low[2] + _CUT * (high[2] - low[2])
        self.gaussians, self.added, self.removed = (
            array[..., below] for array in (recording.gaussians, recording.added, recording.removed)
        )

    def map_at(self, frame: int) -> np.ndarray:  # [MAP_HEIGHT, WIDTH, 3] uint8
        """Return the map at a frame, with the camera and its path."""
        alive = (self.added <= frame) & (self.removed > frame)
        shown = render(np.ascontiguousarray(self.gaussians[:, alive]), int(alive.sum()), self.camera, self.pose)
        image = np.clip(shown.color + (1.0 - shown.alpha[..., None]) * np.array(PAPER) / 255, 0.0, 1.0)
        image = (image * 255 + 0.5).astype(np.uint8)
        poses = self.recording.poses[: pose_number(self.recording, frame) + 1]
        lines = [poses[:, :3, 3], *_frustum(poses[-1], self.recording.camera)]
        for line, width in zip(lines, (4, *[3] * 5)):
            seen = (line - self.pose[:3, 3]) @ self.pose[:3, :3]
            pixels = np.round(self.camera.project(seen)).astype(np.int32)
            cv2.polylines(image, [pixels.reshape(-1, 1, 2)], False, PATH, width, cv2.LINE_AA)
        return image


def outside_pose(bounds: np.ndarray, start: np.ndarray, aspect: float) -> np.ndarray:  # [4, 4] world_from_camera
    """Return the pose from which the replay page shows a workspace at first: from the corner nearest to the start.

    ``bounds`` [2, 3] are the workspace's corners and ``start`` [3] is the camera's first position, in metres.
    ``aspect`` is the width of the image divided by its height.
    """
    low, high = bounds
    side = start - (low + high) / 2
    yaw = _YAW + np.pi / 2 * np.round((np.arctan2(side[1], side[0]) - _YAW) / (np.pi / 2))
    target = low + np.array([0.5, 0.5, 0.25]) * (high - low)
    away = _DISTANCE * np.hypot(*(high - low)[:2]) * max(1.0, 1.3 / aspect)
    back = np.array([np.cos(_PITCH) * np.cos(yaw), np.cos(_PITCH) * np.sin(yaw), np.sin(_PITCH)])
    right = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(right, back), -back])  # right, down, forward
    pose[:3, 3] = target + away * back
    return pose


def pose_number(recording: Recording, frame: int) -> int:
    """Return the index of the camera pose at a frame. Frames spent in place have no pose of their own."""
    frames = np.array([moment.frame for moment in recording.moments])
    now = int(np.searchsorted(frames, frame, side="right")) - 1
    following = recording.moments[min(now + 1, len(frames) - 1)].poses
    return min(recording.moments[now].poses + frame - int(frames[now]), following, len(recording.poses)) - 1


def _frustum(pose: np.ndarray, camera: tuple[float, float, float, float, int, int]) -> list[np.ndarray]:
    """Return the edges of a camera's field of view, 0.55 m deep, as lines [n, 3] in metres."""
    fx, fy, cx, cy, width, height = camera
    corners = np.array(
        [[(u - cx) / fx, (v - cy) / fy, 1.0] for u, v in ((0, 0), (width, 0), (width, height), (0, height))]
    )
    corners = pose[:3, 3] + 0.55 * corners @ pose[:3, :3].T
    return [corners[[0, 1, 2, 3, 0]], *(np.array([pose[:3, 3], corner]) for corner in corners)]


@dataclass(frozen=True)
class _Curve:
    """Hold the curve of a run."""

    name: str
    unit: str
    frames: np.ndarray  # [N] increasing
    values: np.ndarray  # [N]


def _curves(recordings: Sequence[Recording]) -> list[_Curve]:
    """Return a curve per run, or none if the runs have no metric of `_MEASURES` in common."""

    def points(curve: Sequence[Mapping[str, float]], key: str) -> tuple[np.ndarray, np.ndarray]:
        kept = [(point["frames"], point[key]) for point in curve if point.get(key) is not None]
        frames, values = np.array(kept, float).reshape(-1, 2).T
        return frames, values

    for key, name, unit in _MEASURES:
        found = [_Curve(name, unit, *points(one.run.metrics["curve"], key)) for one in recordings]
        if all(len(curve.values) for curve in found):
            return found
    return []


def _chart(own: _Curve, curves: Sequence[_Curve], frame: int, end: int, tint: tuple[int, int, int]) -> Image.Image:
    """Draw the curve of one run up to a frame, with ticks and its present value. All runs have the same axes."""
    top = 100.0 if own.unit == "%" else float(np.ceil(max(curve.values.max() for curve in curves) / 10) * 10)
    room = text_width(f"{top:.1f} {own.unit}", LARGE, bold=True) + 3 * MARGIN  # of the value to the right of the axis
    left, right, upper, lower = 84, WIDTH - room, 60, CURVE_HEIGHT - 46
    page = Image.new("RGB", (WIDTH, CURVE_HEIGHT), PAPER)
    write(page, (MARGIN, 0), own.name, size=SMALL, fill=INK)
    image = np.asarray(page).copy()
    for share in (0.0, 0.5, 1.0):
        y = round(lower - share * (lower - upper))
        cv2.line(image, (left, y), (right, y), HAIR, 1, cv2.LINE_AA)
    until = np.append(own.frames[own.frames < frame], frame)
    values = np.interp(until, own.frames, own.values)
    x = left + (right - left) * (until - 1) / max(end - 1, 1)
    y = lower - (lower - upper) * values / top
    dots = np.round(np.column_stack([x, y])).astype(np.int32)
    cv2.polylines(image, [dots.reshape(-1, 1, 2)], False, tint, 5, cv2.LINE_AA)
    cv2.circle(image, dots[-1].tolist(), 8, tint, -1, cv2.LINE_AA)
    page = Image.fromarray(image)
    for share in (0.0, 0.5, 1.0):
        place = left - 10, lower - share * (lower - upper)
        write(page, place, f"{share * top:g}", size=SMALL, fill=FAINT_INK, anchor="rm")
    write(page, (right, lower + 6), f"frame {frame}", size=SMALL, fill=FAINT_INK, anchor="ra")
    text = f"{values[-1]:.1f} {own.unit}"
    write(page, (WIDTH - MARGIN, (upper + lower) / 2), text, size=LARGE, bold=True, fill=tint, anchor="rm")
    return page


def _rgb(text: str) -> tuple[int, int, int]:  # "#RRGGBB"
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)
