"""Use a planner as a library: it gets pictures and returns the next view."""

from __future__ import annotations

import os
import queue
import shutil
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.config import Preset, configure
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.episode import run_job
from activestructure_gym.evaluation.running.surroundings import captures_in_progress, world_hash
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.policies import canonical_policy, make_policy
from activestructure_gym.policies.native_settings import Setup
from activestructure_gym.specs import Spec
from activestructure_gym.worlds import CaptureFailed, Start, StoredCaptures, checked_bounds, checked_start, frame_from

if TYPE_CHECKING:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.reconstruction import Reconstruction

SCENE = Spec("world:explorer")  # scene of the runs that an explorer saves


@dataclass(frozen=True)
class Goal:
    """Hold the pose of the next picture and the path to it. Poses are ``world_from_camera``, in metres.

    Attributes
    ----------
    pose
        [4, 4] pose of the next picture, the last one of ``path``.
    path
        [P, 4, 4] poses that lead to it, one per frame of the budget. They keep the configured clearance to space that
        is not known to be free.
    view
        [4, 4] view that the policy has chosen. Pictures are also taken on the path to it, every ``keyframe_every``
        frames, because the map then shows obstacles before the camera reaches them.
    scores
        Features of the chosen view by name.
    """

    pose: np.ndarray
    path: np.ndarray
    view: np.ndarray
    scores: dict[str, float]


class Explorer:
    """Plan views without a Gymnasium loop: the caller moves the camera, the explorer maps and decides.

    The environment and ``asg compare`` run the same episode; here its world is the caller. The episode runs in a
    thread of its own and waits for each picture.

    Parameters
    ----------
    policy
        Name of any registered policy, or ``package.module:Class``, with options: ``"active_gs?travel=shared"``.
    camera
        Intrinsics of the pictures; other sizes of equal aspect ratio are resized.
    bounds
        Lowest and highest corner [2, 3] of the space to explore, in metres, z up.
    start
        ``world_from_camera`` [4, 4] of the first picture.
    free_radius
        Radius in metres of a sphere around the start that is known to be free.
    preset
        ``"rl"``, ``"fast"``, ``"default"``, ``"full"`` or ``"paper"``.
    config
        Changes of the preset by field: ``{"mapper.iterations": 8}``.
    frame_budget
        Frames of the episode, the first one included. Default: the preset's.
    setup
        ``"shared"``, or ``"native"`` for the policy's own candidates, keyframes and mapper.
    seed
        Determines every random choice of planner and map.
    directory
        Folder for the run. Every picture is stored next to it (``DIRECTORY.captures``), so an explorer with the same
        arguments and directory continues an episode that was interrupted, with the next goal of `next_view`. Default: a
        temporary folder.

    Raises
    ------
    InputError
        For an unknown policy, or an invalid camera, pose, bounds or configuration.

    Examples
    --------
    >>> from activestructure_gym.worlds import load_world
    >>> robot = load_world("simulated?scene=box&width=64&height=36")
    >>> explorer = Explorer(
    ...     "hole_area", camera=robot.camera, bounds=robot.bounds, start=robot.start.pose, preset="fast", frame_budget=9
    ... )
    >>> while (goal := explorer.next_view()) is not None:
    ...     frame = robot.capture(goal.pose)
    ...     explorer.observe(frame.rgb, frame.depth, frame.world_from_camera)
    >>> explorer.reconstruction.frames
    9
    >>> explorer.close()
    """

    def __init__(
        self,
        policy: str = "activestructure",
        *,
        camera: PinholeCamera,
        bounds: Any,
        start: Any,
        free_radius: float = 0.6,
        preset: Preset = "default",
        config: Mapping[str, Any] | None = None,
        frame_budget: int | None = None,
        setup: Setup = "shared",
        seed: int = 0,
        directory: str | os.PathLike[str] | None = None,
    ) -> None:
        if not isinstance(camera, PinholeCamera):
            raise InputError(f"an explorer needs the PinholeCamera of its pictures as camera, got {camera!r}")
        corners = checked_bounds(bounds)
        begin = checked_start(Start(start, free_radius), corners)
        conditions = Conditions(preset=preset, frame_budget=frame_budget, overrides=config or {}, setup=setup)
        self._job = Job(SCENE, canonical_policy(policy), seed, world_hash(SCENE), conditions)
        configure(conditions.preset, conditions.changes(make_policy(policy)))  # raises the error of a wrong field here
        self._temporary = Path(tempfile.mkdtemp(prefix="asg-explorer-")) if directory is None else None
        self.directory = Path(directory) if directory is not None else Path(f"{self._temporary}/run")
        if self.directory.exists():
            raise InputError(f"'{self.directory}' exists already: choose another directory for the run")
        self._robot = _Caller(corners, camera, begin)
        self._goal: Goal | None = None  # that `observe` answers
        self._env: ReconstructionEnv | None = None
        self._error: BaseException | None = None  # of the episode
        self._raised = False  # whether the caller has received it
        world = StoredCaptures(captures_in_progress(self.directory), self._robot)
        self.resumed = world.stored > 0
        self._thread = threading.Thread(target=self._run, args=(world,), name="explorer", daemon=True)
        self._thread.start()

    @property
    def reconstruction(self) -> Reconstruction:
        """Return the episode with map, volume and planes; read it between `next_view` and `observe` only."""
        if self._env is None:
            raise InputError("there is no map before the first picture: call observe() first")
        return self._env.reconstruction

    def observe(self, rgb: Any, depth: Any, pose: Any) -> None:
        """Add the picture that the last `next_view` asked for; the first picture is taken at the start.

        Parameters
        ----------
        rgb
            [H, W, 3] uint8, or floating-point numbers in 0..1.
        depth
            [H, W] metres along the optical axis. 0 or NaN: not measured. Infinite: no surface.
        pose
            ``world_from_camera`` [4, 4] where the picture was really taken. If this is farther from the goal than one
            frame's step or turn, the path ends there and another view is chosen.

        Raises
        ------
        InputError
            For other arrays, or if no picture is asked for.
        """
        goal = self._asked_for()
        if goal is None:
            raise InputError("the exploration has ended, so no picture is asked for")
        frame = frame_from(rgb, depth, pose, self._robot.camera)
        self._goal = None
        self._robot.answers.put(frame)

    def failed(self, reason: str = "the view could not be reached") -> None:
        """Report that the picture could not be taken; another view is chosen. The fourth failure in a row is raised."""
        if self._asked_for() is not None:
            self._goal = None
            self._robot.answers.put(CaptureFailed(reason))

    def next_view(self) -> Goal | None:
        """Return where to take the next picture; None if the exploration has ended.

        It ends when the frame budget is used up, when no view is left, when the policy ends it, or after `stop`. Raise
        any error of the policy or of the map.
        """
        return self._asked_for()

    def stop(self) -> None:
        """End the exploration; pictures that were given stay part of the run."""
        self._robot.stopped = True
        if self._asked_for() is not None:
            self._goal = None
            self._robot.answers.put(CaptureFailed("stopped"))
        self._thread.join()

    def save(self, directory: str | os.PathLike[str] | None = None) -> Path:
        """Stop, write the run and return its directory: map, planes, trajectory, pictures, captured frames.

        ``asg replay``, ``asg report`` and ``asg export`` read it. ``directory`` must not exist yet. Default: the
        explorer's own directory.
        """
        target = self.directory if directory is None else Path(directory)
        if target != self.directory and target.exists():
            raise InputError(f"'{target}' exists already: choose another directory for the run")
        if self._asked_for() is not None and getattr(self.reconstruction, "chosen", None) is None:
            raise InputError("there is no picture to save a run of: call observe() first")
        self.stop()
        self._raise()
        if target != self.directory:
            shutil.copytree(self.directory, target)
        elif self._temporary is not None:
            raise InputError("save() needs a directory, since this explorer was made without one")
        return target

    def close(self) -> None:
        """Stop, and delete the temporary folder; may be called twice. Raise an error of the episode once."""
        received = self._raised
        try:
            self.stop()
            self._raise()
        except BaseException as error:
            if error is not self._error or not received:
                raise
        finally:
            if self._temporary is not None:
                shutil.rmtree(self._temporary, ignore_errors=True)

    def _asked_for(self) -> Goal | None:
        """Return the goal that the episode waits at; None if it has ended. Raise its error."""
        while self._goal is None:
            ended = not self._thread.is_alive()  # read before the queue: the thread may add a request and end
            with suppress(queue.Empty):
                self._goal = self._goal_of(self._robot.requests.get(timeout=0.0 if ended else 0.05))
                break
            if ended:
                self._raise()
                return None
        return self._goal

    def _raise(self) -> None:
        if self._error is not None:
            self._raised = True
            raise self._error

    def _goal_of(self, path: np.ndarray) -> Goal:
        episode = self.reconstruction
        row = getattr(episode, "chosen", None)
        if row is None:  # the start
            return Goal(path[-1], path, path[-1], {})
        scores = dict(zip(episode.config.features, map(float, episode.features[row])))
        return Goal(path[-1], path, episode.candidates.world_from_camera[row], scores)

    def _begun(self, env: ReconstructionEnv) -> None:
        self._env = env

    def _run(self, world: StoredCaptures) -> None:
        try:
            run_job(self._job, self.directory, world=world, begun=self._begun)
        except BaseException as error:
            if not (self._robot.stopped and isinstance(error, CaptureFailed)):  # the answer to a request after `stop`
                self._error = error


class _Caller:
    """Hand over the requests of an episode to another thread, and wait for its pictures: the world of an explorer."""

    def __init__(self, bounds: np.ndarray, camera: PinholeCamera, start: Start) -> None:
        self.bounds, self.camera, self.start = bounds, camera, start
        self.stopped = False
        self.requests: queue.Queue[np.ndarray] = queue.Queue()  # paths [P, 4, 4]
        self.answers: queue.Queue[Frame | CaptureFailed] = queue.Queue()
        self._path: np.ndarray | None = None

    def travel(self, path: np.ndarray) -> None:
        """Note the path, which belongs to the next capture."""
        self._path = path

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Return the picture that the other thread gives for the path."""
        if self.stopped:
            raise CaptureFailed("stopped")
        assert self._path is not None
        self.requests.put(self._path)
        answer = self.answers.get()
        if isinstance(answer, CaptureFailed):
            raise answer
        return answer

    def close(self) -> None:
        """Do nothing: the camera is the caller's."""
