"""Run one compiled kernel on a few worker threads together.

Raw locks wake a worker in a few microseconds; a thread pool needs about 20, and OpenMP threads spin and break under
fork. The kernels release the GIL and share their work by atomic tickets, so the team only has to call the same function
once per thread.
"""

from __future__ import annotations

import _thread
import os
import time
from collections.abc import Callable

from activestructure_gym.cores import core_count

MAX_THREADS = 8  # an image has too few tiles for more
_LOAD_IS_FRESH_S = 1.0
# time.monotonic() from which the load is read again, and whether the machine was crowded at the last reading
_crowded_until: tuple[float, bool] = (0.0, False)


def default_threads() -> int:
    """Return the number of threads for a kernel: the cores of this process, at most `MAX_THREADS`.

    ``OMP_NUM_THREADS`` can lower it. On an overloaded machine it is 1, because all threads wait for the slowest one.
    Results do not depend on it.
    """
    cores = core_count()
    wish = os.environ.get("OMP_NUM_THREADS", "")
    threads = min(cores, MAX_THREADS, int(wish) if wish.isdigit() and int(wish) > 0 else cores)
    return 1 if threads > 1 and _machine_is_crowded() else threads


def _machine_is_crowded() -> bool:
    """Return whether there were more than 1.5 runnable tasks per core over the last minute."""
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
            except BaseException as error:  # handed to the caller by `run`
                self.error = error
            self.job = None
            self.done.release()


class ThreadTeam:
    """Call a kernel on several threads at once, and return when all calls that began have returned.

    The kernel must complete its work with any number of threads.
    """

    def __init__(self) -> None:
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy = _thread.allocate_lock()

    def run(self, kernel: Callable, arguments: tuple, threads: int) -> None:
        """Call ``kernel(*arguments)`` on up to ``threads`` threads, including the calling one.

        If another Python thread uses the team meanwhile, the calling thread works alone, with the same result.
        """
        if self._process != os.getpid():  # threads do not survive a fork, nor does the state of their locks
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
                # A worker that has not started by now has nothing left to do. Its call is taken back, because a busy
                # machine might start it late.
                called = [worker for worker in called if not worker.start.acquire(blocking=False)]
                for worker in called:
                    worker.done.acquire()
                consistent = True
            for worker in called:
                error, worker.error = worker.error, None
                if error is not None:
                    raise error
        finally:
            if not consistent:  # after Ctrl-C the locks may be in any state; the next call gets new workers
                self._workers = []
            self._busy.release()


TEAM = ThreadTeam()
