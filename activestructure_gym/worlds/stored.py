"""Store every capture of an episode, so that the episode can be resumed, replayed and measured without its world.

A folder of captures holds::

    world.json     bounds, camera, start.
    views.npz      the poses that can be captured, if the world has `Views`.
    000000.npz     the first frame: rgb, depth, pose (where it was taken), asked (the pose that was asked for).
    000001.npz     the second frame, and so on.
    000002.failed  the message of a capture, or of the travel to it, that failed, in place of its frame.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.files import replaced
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.npz import read_npz
from activestructure_gym.worlds.base import (
    CaptureFailed,
    Start,
    Views,
    World,
    captured,
    checked_bounds,
    checked_start,
)

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import GroundTruth

WORLD_FILE = "world.json"
_VIEWS_FILE = "views.npz"
_FORMAT = 1
_DIGITS = 6  # of a frame's file name


class StoredCaptures:
    """Return the stored captures of an episode first, then capture in a world and store that.

    Planning depends only on the seed and the frames, so an episode that gets its stored frames again asks for the same
    poses. It therefore continues where it was interrupted.

    Parameters
    ----------
    folder
        Folder of the captures; made if it is missing. Failures at its end are forgotten if a world is given.
    world
        The world to capture in after the stored frames; None to replay only.

    Raises
    ------
    InputError
        If files of the folder are damaged or missing, or it is empty and no world is given.
    """

    def __init__(self, folder: str | os.PathLike[str], world: World | None = None) -> None:
        self.folder, self.world = Path(folder), world
        self._next = 0
        self._facts = self._read() if (self.folder / WORLD_FILE).exists() else None
        if self._facts is None and world is None:
            raise InputError(f"'{self.folder}' holds no captures to replay: it has no {WORLD_FILE}")
        self._views: Views | None = None
        if (self.folder / _VIEWS_FILE).exists():
            arrays = _read_arrays(self.folder / _VIEWS_FILE, ("world_from_camera", "free_radius"))
            self._views = Views(arrays["world_from_camera"], arrays["free_radius"])
        if later := [number for number in self._numbers() if number > self.stored]:
            raise InputError(
                f"'{self.folder}' has no capture {self.stored}, but later ones up to {max(later)}: restore it, or "
                "delete the later ones and resume"
            )
        while world is not None and self._failure(self.stored - 1).exists():
            self._failure(self.stored - 1).unlink()  # the world is asked again

    @property
    def exhausted(self) -> bool:
        """Return whether the next capture is neither stored nor can be taken."""
        return self.world is None and not self._is_stored(self._next)

    @property
    def is_over(self) -> bool:
        """Return whether the episode ends here: no capture is left, or the world was stopped."""
        return self.exhausted or self.stopped

    @property
    def stopped(self) -> bool:
        """Return whether the world was stopped."""
        return bool(getattr(self.world, "stopped", False))

    @property
    def stored(self) -> int:
        """Return the number of stored captures."""
        count = 0
        while self._is_stored(count):
            count += 1
        return count

    def _numbers(self) -> list[int]:
        """Return the numbers of all files of captures, failed ones included."""
        files = [file for end in ("npz", "failed") for file in self.folder.glob(f"{'[0-9]' * _DIGITS}.{end}")]
        return [int(file.stem) for file in files]

    def _is_stored(self, number: int) -> bool:
        return self._file(number).exists() or self._failure(number).exists()

    @property
    def bounds(self) -> np.ndarray:
        """Return the bounds [2, 3] of the world."""
        return self._read_or_ask()[0]

    @property
    def camera(self) -> PinholeCamera:
        """Return the camera of the world."""
        if self._facts is not None:
            return self._facts[1]
        assert self.world is not None
        return self.world.camera

    @property
    def start(self) -> Start:
        """Return the camera pose at which the episode begins, and the radius of the free sphere around it."""
        return self._read_or_ask()[2]

    @property
    def truth(self) -> GroundTruth | None:
        """Return the ground truth of the world, if there is one."""
        return getattr(self.world, "truth", None)

    @property
    def views(self) -> Views | None:
        """Return the poses that can be captured: the stored ones, or those of the world; None if all poses can."""
        return getattr(self.world, "views", None) if self._views is None else self._views

    def reset(self, seed: int) -> None:
        """Begin the episode, in the world too if nothing is stored yet."""
        self._next = 0
        if self.world is not None and not self._is_stored(0):
            self._facts = self._views = None  # the world may begin elsewhere, with other views
            if (reset := getattr(self.world, "reset", None)) is not None:
                reset(seed)

    def travel(self, path: np.ndarray) -> None:
        """Send the path [P, 4, 4] to the world, unless the frame at its end is stored; store a `CaptureFailed`."""
        if not self._is_stored(self._next) and (travel := getattr(self.world, "travel", None)) is not None:
            self._read_or_ask()  # world.json comes first
            try:
                travel(path)
            except CaptureFailed as error:
                self._store_failure(self._next, error)
                self._next += 1
                raise

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Return the next frame: the stored one, or a new one, which is stored.

        Raise `InputError` if the stored frame was asked for at another pose than ``world_from_camera`` [4, 4], and
        `CaptureFailed` if there is neither a stored frame nor a world.
        """
        number = self._next
        if self.exhausted:
            raise CaptureFailed(f"'{self.folder}' holds {number} captures, and the episode asks for another one")
        self._next += 1
        if (failure := self._failure(number)).exists():
            raise CaptureFailed(failure.read_text(encoding="utf-8", errors="replace"))
        if self._file(number).exists():
            return self._stored_frame(self._file(number), world_from_camera)
        assert self.world is not None
        self._read_or_ask()  # world.json comes first
        try:
            frame = captured(self.world, world_from_camera)
        except CaptureFailed as error:
            self._store_failure(number, error)
            raise
        images = {"rgb": np.asarray(frame.rgb), "depth": np.asarray(frame.depth)}
        poses = {"pose": np.asarray(frame.world_from_camera), "asked": np.asarray(world_from_camera)}
        with replaced(self._file(number)) as stream:
            np.savez_compressed(stream, **images, **poses)  # type: ignore[arg-type]
        return frame

    def frame(self, number: int) -> Frame:
        """Return frame ``number`` of those that did not fail, counted from 0; raise `InputError` if it is damaged."""
        taken = [file for k in range(self.stored) if (file := self._file(k)).exists()]
        if number >= len(taken):
            raise InputError(f"'{self.folder}' holds {len(taken)} frames, and frame {number} is asked for")
        return self._stored_frame(taken[number])

    def close(self) -> None:
        """Release the world."""
        if self.world is not None:
            self.world.close()

    def _file(self, number: int) -> Path:
        return self.folder / f"{number:0{_DIGITS}}.npz"

    def _failure(self, number: int) -> Path:
        return self.folder / f"{number:0{_DIGITS}}.failed"

    def _store_failure(self, number: int, error: CaptureFailed) -> None:
        with replaced(self._failure(number)) as stream:
            stream.write(str(error).encode())

    def _stored_frame(self, file: Path, wanted: np.ndarray | None = None) -> Frame:
        arrays = _read_arrays(file, ("asked", "rgb", "depth", "pose"))
        if wanted is not None and not np.array_equal(arrays["asked"], wanted):
            raise InputError(
                f"'{file}' was taken for another pose than the episode now asks for: the code, the settings or the "
                "seed have changed since; begin a new episode in another folder"
            )
        return Frame(rgb=arrays["rgb"], depth=arrays["depth"], world_from_camera=arrays["pose"], camera=self.camera)

    def _read_or_ask(self) -> tuple[np.ndarray, PinholeCamera, Start]:
        """Return the facts of ``world.json``; take them from the world and write the file if there is none."""
        if self._facts is None:
            assert self.world is not None
            bounds = checked_bounds(self.world.bounds)
            camera, start = self.world.camera, checked_start(self.world.start, bounds)
            content = {
                "format": _FORMAT,
                "bounds": bounds.tolist(),
                "camera": asdict(camera),
                "start": {"pose": start.pose.tolist(), "free_radius": start.free_radius},
            }
            self.folder.mkdir(parents=True, exist_ok=True)
            if (views := self.views) is not None:
                with replaced(self.folder / _VIEWS_FILE) as stream:
                    poses, radii = views.world_from_camera, views.free_radius
                    np.savez_compressed(stream, world_from_camera=poses, free_radius=radii)
            with replaced(self.folder / WORLD_FILE) as stream:
                stream.write((json.dumps(content, indent=1) + "\n").encode())
            self._facts = bounds, camera, start
        return self._facts

    def _read(self) -> tuple[np.ndarray, PinholeCamera, Start]:
        file = self.folder / WORLD_FILE
        try:
            content: Any = json.loads(file.read_text(encoding="utf-8"))
            if content["format"] != _FORMAT:
                raise ValueError(f"format {content['format']} is unknown")
            bounds = checked_bounds(content["bounds"])
            width, height = (int(content["camera"][name]) for name in ("width", "height"))
            lens = [float(content["camera"][name]) for name in ("fx", "fy", "cx", "cy")]
            if not all(map(math.isfinite, lens)):
                raise ValueError("its camera has numbers that are not finite")
            camera = PinholeCamera(width, height, *lens)
            start = Start(np.array(content["start"]["pose"], np.float64), float(content["start"]["free_radius"]))
            return bounds, camera, checked_start(start, bounds)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"'{file}' is damaged: {error}") from error


def _read_arrays(file: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return the named arrays of a file; raise `InputError` if it is damaged or lacks one."""
    try:
        arrays = read_npz(file)
        if missing := set(names) - arrays.keys():
            raise ValueError(f"it lacks {', '.join(sorted(missing))}")
    except (OSError, ValueError) as error:
        raise InputError(f"'{file}' is damaged: {error}; delete it and all later captures, and resume") from error
    return arrays
