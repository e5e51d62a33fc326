"""Make a world of a recorded RGB-D sequence: a capture returns the nearest recorded frame."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from activestructure_gym.errors import InputError, InputWarning, unknown_name
from activestructure_gym.geometry import rotation_angle
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.motion import levelled
from activestructure_gym.scenes import load_sequence
from activestructure_gym.scenes.loaders.mesh_loader import upright
from activestructure_gym.scenes.loaders.upright import UP_AXES
from activestructure_gym.worlds.base import Start, Views, checked_bounds
from activestructure_gym.worlds.frames import frame_from
from activestructure_gym.worlds.registry import WORLDS

_METRES_PER_RADIAN = 0.1 / np.radians(10.0)  # a step and a turn of one frame count the same: 0.1 m and 10 degrees
_SAMPLED_FRAMES, _SAMPLED_PIXELS = 50, 8  # bounds and free radii use 50 frames, of these every 8th pixel per side
_PERCENTILES = (0.5, 99.5)  # of the depth points; the rest may be noise
_SURFACE_MARGIN_M, _CAMERA_MARGIN_M = 0.1, 0.6
# Free around a recorded pose: 0.9 of the distance to the nearest sampled depth point, at most 0.4 m for the camera and
# its carrier. Surfaces that no frame shows may be closer than the nearest point.
_CLOSEST, _CARRIER_M = 0.9, 0.4
_UPRIGHT = 0.5  # smallest cosine between the up axis and the up direction of most images, else a warning


@WORLDS.register("recorded")
class RecordedWorld:
    """Explore a recorded RGB-D sequence. The candidate views are the recorded poses.

    `capture` returns the recorded frame nearest to the wanted pose, with its own pose. The distance is that of the
    positions in metres plus 0.57 m per radian of rotation, so one step (0.1 m) counts as much as one turn (10 degrees).
    Rotations are compared without roll. A frame can be captured any number of times.

    Space around every recorded pose counts as free, up to 0.9 of the distance to the nearest depth point and 0.4 m.

    Parameters
    ----------
    path
        Folder of the sequence, in a layout of `load_sequence`: Redwood, TUM or NICE-SLAM.
    width
        Width of the images in pixels, at most the recorded one. 0 means the recorded size.
    up
        Axis of the recording that points up: x, y, z, -x, -y or -z. In the frame of a first camera held level it is -y.
    hold_out
        Keep every n-th frame for evaluation (`held_out`), without ever capturing it. 0 keeps none.
    depth_scale
        Depth image value per metre. Default: see `load_sequence`.
    intrinsics
        Focal lengths and principal point fx, fy, cx, cy in pixels of the recorded images. Default: see `load_sequence`.
    bounds
        Lowest and highest corner x, y, z, x, y, z in metres, z up. Default: the 0.5 and 99.5 percentiles of the depth
        points with a margin of 0.1 m, extended to 0.6 m around every camera position.
    """

    def __init__(
        self,
        path: str,
        *,
        width: int = 160,
        up: str = "z",
        hold_out: int = 0,
        depth_scale: float | None = None,
        intrinsics: tuple[float, float, float, float] | None = None,
        bounds: tuple[float, float, float, float, float, float] | None = None,
    ) -> None:
        if up not in UP_AXES:
            raise unknown_name("up axis", up, UP_AXES)
        sequence = self._sequence = load_sequence(path, intrinsics=intrinsics, depth_scale=depth_scale)
        recorded = sequence.camera
        if not (width == 0 or 8 <= width <= recorded.width):
            raise InputError(f"width must be 0 or from 8 to the recorded {recorded.width} pixels, got {width}")
        if hold_out != 0 and not 2 <= hold_out <= len(sequence):
            raise InputError(f"hold_out must be 0, or from 2 to the number of frames {len(sequence)}, got {hold_out}")
        width = width or recorded.width
        self.camera = recorded.resized(width, max(1, round(recorded.height * width / recorded.width)))
        self._poses = sequence.world_from_camera.copy()
        self._poses[:, :3] = upright(np.eye(3), up).T @ self._poses[:, :3]
        ups = {axis: _image_up(sequence.world_from_camera, axis) for axis in UP_AXES}
        if ups[up] < _UPRIGHT:
            best = max(UP_AXES, key=lambda axis: ups[axis])
            text = f"the images of '{path}' are not upright with up={up}: up={best} fits best"
            warnings.warn(text, InputWarning, stacklevel=2)
        self._level = np.stack([levelled(pose) for pose in self._poses])
        kept = np.ones(len(sequence), dtype=bool)
        if hold_out:
            kept[hold_out // 2 :: hold_out] = False
        self._held_out, self._captured = np.flatnonzero(~kept), np.flatnonzero(kept)
        points, places = self._sampled_points(), self._poses[:, :3, 3]
        if bounds is None:
            low, high = np.percentile(points, _PERCENTILES, axis=0)
            low = np.minimum(low - _SURFACE_MARGIN_M, places.min(axis=0) - _CAMERA_MARGIN_M)
            high = np.maximum(high + _SURFACE_MARGIN_M, places.max(axis=0) + _CAMERA_MARGIN_M)
            self.bounds = checked_bounds([low, high])
        else:
            self.bounds = checked_bounds([bounds[:3], bounds[3:]])
        radii = _CLOSEST * cKDTree(points).query(places[self._captured])[0]
        self.views = Views(self._poses[self._captured], np.clip(radii, 1e-3, _CARRIER_M))
        self.start = Start(self._poses[self._captured[0]], float(self.views.free_radius[0]))

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Return the recorded frame nearest to a pose [4, 4], with its own pose."""
        return self._frame(self.nearest(world_from_camera))

    def nearest(self, world_from_camera: np.ndarray) -> int:
        """Return the number of the recorded frame nearest to a pose [4, 4]; frames that are held out are left out."""
        level = self._level[self._captured]
        wanted = levelled(np.asarray(world_from_camera, dtype=np.float64))
        metres = np.linalg.norm(level[:, :3, 3] - wanted[:3, 3], axis=1)
        return int(self._captured[np.argmin(metres + _METRES_PER_RADIAN * rotation_angle(level, wanted))])

    def held_out(self) -> Iterator[Frame]:
        """Yield the frames that are never captured."""
        for index in self._held_out.tolist():
            yield self._frame(index)

    def close(self) -> None:
        """Do nothing: images are read one at a time."""

    def _frame(self, index: int) -> Frame:
        frame = self._sequence.frame(index)
        return frame_from(frame.rgb, frame.depth, self._poses[index], self.camera)

    def _sampled_points(self) -> np.ndarray:  # [N, 3] metres, world
        """Return points of the depth images; raise `InputError` if there are none."""
        count, step = len(self._sequence), _SAMPLED_PIXELS
        points = []
        for index in np.unique(np.linspace(0, count - 1, min(count, _SAMPLED_FRAMES)).round().astype(int)).tolist():
            depth = self._sequence.frame(index).depth
            sampled = np.zeros_like(depth)
            sampled[step // 2 :: step, step // 2 :: step] = depth[step // 2 :: step, step // 2 :: step]
            frame = Frame(np.zeros((*depth.shape, 3), np.uint8), sampled, self._poses[index], self._sequence.camera)
            points.append(frame.world_points())
        found = np.concatenate(points)
        if not len(found):
            raise InputError("the depth images of this sequence have no depth above 0, so nothing can be mapped")
        return found


def _image_up(world_from_camera: np.ndarray, axis: str) -> float:  # [n, 4, 4] of the recording
    """Return the median cosine between an axis of the recording and the up direction of its images."""
    return float(np.median(-world_from_camera[:, :3, 1] @ upright(np.eye(3), axis)[:, 2]))
