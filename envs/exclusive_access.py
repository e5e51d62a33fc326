"""Limit changes of an environment to one thread at a time, and refuse them after it is closed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium as gym


class ExclusiveAccess:
    """Refuse calls from a second thread and calls on a closed environment; instances can be copied and pickled."""

    def __init__(self) -> None:
        self.closed = False
        self._free = [True]  # empty while a call runs; `list.pop` is atomic

    def check_open(self, call: str) -> None:
        """Raise `gymnasium.error.ClosedEnvironmentError` if the environment is closed; ``call`` names the method."""
        if self.closed:
            raise gym.error.ClosedEnvironmentError(f"{call}() was called on a closed environment: make a new one")

    @contextmanager
    def claim(self, call: str) -> Iterator[None]:
        """Hold exclusive access while the block runs.

        Raises `gymnasium.error.AlreadyPendingCallError` if another call holds it, and
        `gymnasium.error.ClosedEnvironmentError` if the environment is closed.
        """
        self.check_open(call)
        try:
            token = self._free.pop()
        except IndexError:
            raise gym.error.AlreadyPendingCallError(
                f"{call}() was called while another thread is in step() or reset() of this environment: give every "
                "thread an environment of its own",
                call,
            ) from None
        try:
            yield
        finally:
            self._free.append(token)
