"""A few worker threads that run one compiled kernel together.

Raw locks wake a worker in a few microseconds; a thread pool needs about 20, and OpenMP threads spin and break under
fork. The kernels release the GIL and share their work by atomic tickets, so the crew only has to call the same function
once per thread.
"""

from __future__ import annotations

import _thread
import os
from collections.abc import Callable


def default_threads() -> int:
    """The cores this process may use, or fewer if OMP_NUM_THREADS says so."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    wish = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(cores, int(wish))) if wish.isdigit() and int(wish) > 0 else cores


class _Worker:
    def __init__(self) -> None:
        self.job: tuple[Callable, tuple] | None = None
        self.error: BaseException | None = None
        self.start, self.done = _thread.allocate_lock(), _thread.allocate_lock()
        self.start.acquire()
        self.done.acquire()
        _thread.start_new_thread(self._loop, ())

    def _loop(self) -> None:
        while True:
            self.start.acquire()
            assert self.job is not None
            kernel, arguments = self.job
            try:
                kernel(*arguments)
            except BaseException as error:  # handed to the caller by `run`
                self.error = error
            self.job = None
            self.done.release()


class Crew:
    """Calls a kernel on several threads at once and waits for all."""

    def __init__(self) -> None:
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy = _thread.allocate_lock()

    def run(self, kernel: Callable, arguments: tuple, threads: int) -> None:
        """``kernel(*arguments)`` on ``threads`` threads, this one included.

        A second Python thread that comes while the crew is out works alone: tickets make that the same result.
        """
        if self._process != os.getpid():  # threads do not survive a fork, nor does the state of their locks
            self._workers, self._process, self._busy = [], os.getpid(), _thread.allocate_lock()
        if threads <= 1 or not self._busy.acquire(blocking=False):
            kernel(*arguments)
            return
        try:
            while len(self._workers) < threads - 1:
                self._workers.append(_Worker())
            called = self._workers[: threads - 1]
            for worker in called:
                worker.job = (kernel, arguments)
                worker.start.release()
            try:
                kernel(*arguments)
            finally:
                for worker in called:
                    worker.done.acquire()
            for worker in called:
                error, worker.error = worker.error, None
                if error is not None:
                    raise error
        finally:
            self._busy.release()


CREW = Crew()
