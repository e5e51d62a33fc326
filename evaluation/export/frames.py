"""Choose the frames of a finished run, and draw their colour and depth images at any size from the exact poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import refuse_code
from activestructure_gym.evaluation.archive.store import CAPTURES, CONFIG, Run
from activestructure_gym.evaluation.protocols import CameraPath
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ranges import MAX_ASPECT_RATIO
from activestructure_gym.specs import Spec
from activestructure_gym.worlds import StoredCaptures, frame_from, names_world

if TYPE_CHECKING:
    from activestructure_gym.scenes import Scene

Chosen = Literal["keyframes", "all"]
Images = Iterator[tuple[np.ndarray, np.ndarray]]  # rgb [H, W, 3] uint8, depth [H, W] float32 metres, 0 = no surface
_SUPERSAMPLE = 4  # rays per pixel and axis, as in the true images of the held-out views
_MAX_SIDE = 8192  # pixels


@dataclass(frozen=True)
class PosedFrames:
    """Hold the frames of a run that are written, in the order of the path.

    Parameters
    ----------
    camera
        The camera of all images.
    numbers
        [N] indices of the frames in the run's ``trajectory.npz``.
    world_from_camera
        [N, 4, 4] exact poses, metres.
    images
        Function that yields the colour and the depth image of each frame.
    """

    camera: PinholeCamera
    numbers: np.ndarray
    world_from_camera: np.ndarray
    images: Callable[[], Images]

    def __len__(self) -> int:
        return len(self.numbers)


def posed_frames(run: Run, chosen: Chosen = "keyframes", size: tuple[int, int] | None = None) -> PosedFrames:
    """Return the frames of a run with their images.

    The images of a run in a scene are drawn without noise; depth beyond the sensor's range is 0. A run in a world has
    the images that were captured at its keyframes.

    Parameters
    ----------
    run
        The finished run.
    chosen
        ``"keyframes"``, or ``"all"`` executed poses.
    size
        Width and height of the images in pixels; None means the sensor's. The field of view is the sensor's.

    Raises
    ------
    InputError
        The scene is missing or has changed, the size is out of range, or a world would have to capture again.
    """
    path = CameraPath.from_arrays(run.trajectory)
    numbers = chosen_numbers(run, chosen)
    poses = run.trajectory["world_from_camera"][numbers]
    camera = path.camera if size is None else _resized(path.camera, size)
    if not names_world(run.job.scene):
        scene = _scene_of(run)
        return PosedFrames(camera, numbers, poses, lambda: _drawn(scene, camera, poses, path.max_range))
    if size is not None:
        raise InputError(
            f"'{run.directory}' is a run in a world, whose captures have {path.camera.width} x {path.camera.height} "
            "pixels and cannot be drawn again: leave out --size"
        )
    if chosen == "all":
        raise InputError(
            f"'{run.directory}' is a run in a world, which captured images at its keyframes only: leave out "
            "--frames all"
        )
    captures = StoredCaptures(run.directory / CAPTURES)
    return PosedFrames(camera, numbers, poses, lambda: _captured(captures, camera, len(poses), path.max_range))


def chosen_numbers(run: Run, chosen: Chosen) -> np.ndarray:  # [N]
    """Return the indices of the chosen poses in the run's trajectory."""
    path = run.trajectory
    return np.array(path["keyframes"]) if chosen == "keyframes" else np.arange(len(path["world_from_camera"]))


def _resized(camera: PinholeCamera, size: tuple[int, int]) -> PinholeCamera:
    if not 1 <= min(size) <= max(size) <= _MAX_SIDE or max(size) > MAX_ASPECT_RATIO * min(size):
        raise InputError(
            f"an image has 1 to {_MAX_SIDE} pixels per side, the longer one at most {MAX_ASPECT_RATIO} times the "
            f"shorter one, got {size[0]} x {size[1]}"
        )
    return camera.resized(*size)


def _scene_of(run: Run) -> Scene:
    from activestructure_gym.evaluation.running.recorded_scene import load_job_scene

    # Only the scene of the job is loaded, so the code of its policy is not needed.
    refuse_code([replace(run.job, policy=Spec("random"), conditions=Conditions())], run.directory / CONFIG)
    return load_job_scene(run.job)


def _drawn(scene: Scene, camera: PinholeCamera, poses: np.ndarray, max_range: float) -> Images:
    from activestructure_gym.sensors.renderer import drawn_images

    return drawn_images(scene, camera, poses, supersample=_SUPERSAMPLE, max_range=max_range)


def _captured(captures: StoredCaptures, camera: PinholeCamera, count: int, max_range: float) -> Images:
    for number in range(count):
        taken = captures.frame(number)
        frame = frame_from(taken.rgb, taken.depth, taken.world_from_camera, camera, max_range)
        yield frame.rgb, frame.depth
