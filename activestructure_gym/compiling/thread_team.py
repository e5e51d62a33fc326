"""Run one compiled kernel on several threads at once.

Raw locks wake a thread in a few microseconds; a thread pool needs about 20, and OpenMP threads wait actively and fail
after a fork. Kernels release Python's global interpreter lock and divide their work by atomic counters. So the team
only has to call the same function once per thread.
"""

from __future__ import annotations

import _thread
import os
import time
from collections.abc import Callable

from activestructure_gym.cores import core_count

MAX_THREADS = 8  # an image has too few tiles to occupy more
_LOAD_IS_FRESH_S = 1.0  # seconds for which a reading of the system load is used
# Time (time.monotonic()) at which the load is read again, and whether the machine was overloaded at the last reading.
_crowded_until: tuple[float, bool] = (0.0, False)


def default_threads() -> int:
    """Return the number of threads for a kernel: the cores available to this process, at most `MAX_THREADS`.

    ``OMP_NUM_THREADS`` can lower it. On an overloaded machine it is 1, because all threads wait for the slowest one.
    The results of kernels do not depend on the number of threads.
    """
    cores = core_count()
    wish = os.environ.get("OMP_NUM_THREADS", "")
    threads = min(cores, MAX_THREADS, int(wish) if wish.isdigit() and int(wish) > 0 else cores)
    return 1 if threads > 1 and _machine_is_crowded() else threads


def _machine_is_crowded() -> bool:
    """Return whether the average number of runnable tasks over the last minute was above 1.5 per core."""
    global _crowded_until
    if not hasattr(os, "getloadavg"):
        return False
    now = time.monotonic()
    if now >= _crowded_until[0]:
        _crowded_until = (now + _LOAD_IS_FRESH_S, os.getloadavg()[0] > 1.5 * (os.cpu_count() or 1))
    return _crowded_until[1]


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
            except BaseException as error:  # raised again by `run`
                self.error = error
            self.job = None
            self.done.release()


class ThreadTeam:
    """Call a kernel on several threads at once, and return when all started calls have returned.

    The kernel must complete its work with any number of threads.
    """

    def __init__(self) -> None:
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy = _thread.allocate_lock()

    def run(self, kernel: Callable, arguments: tuple, threads: int) -> None:
        """Call ``kernel(*arguments)`` on up to ``threads`` threads, including the calling one.

        If another Python thread is using the team, only the calling thread runs the kernel, with the same result.
        """
        if self._process != os.getpid():  # threads do not survive a fork, and the state of their locks is lost
            self._workers, self._process, self._busy = [], os.getpid(), _thread.allocate_lock()
        if threads <= 1 or not self._busy.acquire(blocking=False):
            kernel(*arguments)
            return
        consistent = False
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
                # The work is complete, so a worker that has not started is not needed. Its call is cancelled, because a
                # busy machine might start it late.
                called = [worker for worker in called if not worker.start.acquire(blocking=False)]
                for worker in called:
                    worker.done.acquire()
                consistent = True
            for worker in called:
                error, worker.error = worker.error, None
                if error is not None:
                    raise error
        finally:
            if not consistent:  # after Ctrl-C the state of the locks is unknown; the next call gets new workers
                self._workers = []
            self._busy.release()


TEAM = ThreadTeam()
