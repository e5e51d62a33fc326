"""Who may change an environment: one thread at a time, and nobody once it is closed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium as gym


class ExclusiveAccess:
    """Refuses calls of a closed environment, and those of a second thread; it can be copied and pickled."""

    def __init__(self) -> None:
        self.closed = False
        self._free = [True]  # empty while a call is at work; taking from a list is atomic

    def check_open(self, call: str) -> None:
        """Raise `gymnasium.error.ClosedEnvironmentError` for a closed environment."""
        if self.closed:
            raise gym.error.ClosedEnvironmentError(f"{call}() was called on a closed environment: make a new one")

    @contextmanager
    def claim(self, call: str) -> Iterator[None]:
        """Keep others out while the block runs; raise `gymnasium.error.AlreadyPendingCallError` for the second."""
        self.check_open(call)
        try:
            turn = self._free.pop()
        except IndexError:
            raise gym.error.AlreadyPendingCallError(
                f"{call}() was called while another thread is in step() or reset() of this environment: give every "
                "thread an environment of its own",
                call,
            ) from None
        try:
            yield
        finally:
            self._free.append(turn)
