"""Repeat failed captures, and stop waiting for those that take too long."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, one_line, short_repr
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.worlds.base import CaptureFailed, Start, World

_Call = tuple[Callable[..., Any], tuple[Any, ...], "queue.Queue[tuple[bool, Any]]"]


class Reliable:
    """Capture in another world, with further tries and a time limit.

    ``tries=N`` and ``timeout_s=T`` among the options of a world's name wrap it in this class.

    Parameters
    ----------
    world
        The world that captures.
    tries
        How often a capture is tried before `CaptureFailed` is raised.
    timeout_s
        Seconds after which a capture, or the travel to it, counts as failed; None waits forever. Such a call is not
        repeated, since the robot may still be moving. All calls with a time limit run in one thread.

    Raises
    ------
    InputError
        If ``tries`` is no whole number above 0, or ``timeout_s`` is not above 0.
    """

    def __init__(self, world: World, *, tries: int = 1, timeout_s: float | None = None) -> None:
        check_limits(tries=tries, timeout_s=timeout_s)
        self.world, self.tries, self.timeout_s = world, tries, timeout_s
        self._calls: queue.Queue[_Call] | None = None

    def __getattr__(self, name: str) -> Any:
        """Return an optional member of the other world, as it is now."""
        if name not in ("truth", "views", "exact_motion", "reset"):
            raise AttributeError(f"{type(self).__name__} has no attribute '{name}'")
        return getattr(self.world, name)

    @property
    def bounds(self) -> np.ndarray:
        """Return the bounds of the other world."""
        return self.world.bounds

    @property
    def camera(self) -> PinholeCamera:
        """Return the camera of the other world."""
        return self.world.camera

    @property
    def start(self) -> Start:
        """Return the start of the other world."""
        return self.world.start

    def travel(self, path: np.ndarray) -> None:
        """Send the poses [P, 4, 4] of the path; failures are not repeated, since the robot may have moved."""
        if (travel := getattr(self.world, "travel", None)) is not None:
            try:
                self._called(travel, path)
            except CaptureFailed:
                raise
            except Exception as error:
                raise CaptureFailed(f"the world could not travel: {_said(error)}") from error

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Return the frame at a pose [4, 4]; raise `CaptureFailed` after the last try."""
        for number in range(1, self.tries + 1):
            try:
                frame: Frame = self._called(self.world.capture, world_from_camera.copy())
                return frame
            except _TooLate:
                raise
            except Exception as error:
                if number == self.tries:
                    said = f"the world took no frame in {number} tries" if number > 1 else "the world took no frame"
                    raise CaptureFailed(f"{said}: {_said(error)}") from error
        raise AssertionError("tries is at least 1")

    def close(self) -> None:
        """Release the other world."""
        self.world.close()

    def _called(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return ``function(*arguments)``; with a time limit it runs in the thread of this world."""
        if self.timeout_s is None:
            return function(*arguments)
        if self._calls is None:
            self._calls = queue.Queue()
            threading.Thread(target=_serve, args=(self._calls,), name="captures of a world", daemon=True).start()
        answer: queue.Queue[tuple[bool, Any]] = queue.Queue()
        self._calls.put((function, arguments, answer))
        try:
            succeeded, result = answer.get(timeout=self.timeout_s)
        except queue.Empty:
            self._calls = None  # its thread is still busy: a later call gets a new one
            raise _TooLate(f"the world has not answered within {self.timeout_s:g} s") from None
        if not succeeded:
            raise result
        return result


def check_limits(*, tries: int = 1, timeout_s: float | None = None) -> None:
    """Raise `InputError` for values that `Reliable` does not accept."""
    if isinstance(tries, bool) or not isinstance(tries, int) or tries < 1:
        raise InputError(f"tries of a world must be a whole number of at least 1, got {short_repr(tries)}")
    if timeout_s is not None and not (isinstance(timeout_s, int | float) and 0 < timeout_s < 1e6):
        raise InputError(f"timeout_s of a world must be a number of seconds above 0, got {short_repr(timeout_s)}")


class _TooLate(CaptureFailed):
    """Report that the time limit has passed."""


def _serve(calls: queue.Queue[_Call]) -> None:
    while True:
        function, arguments, answer = calls.get()
        try:
            answer.put((True, function(*arguments)))
        except BaseException as error:
            answer.put((False, error))


def _said(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {error}")
