"""A few worker threads that run one compiled kernel together.

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

MAX_THREADS = 8  # by default; a picture has too few tiles to feed more
_LOAD_IS_FRESH_S = 1.0
_crowded_until: tuple[float, bool] = (0.0, False)  # when to look again, what was seen


def default_threads() -> int:
    """The cores this process may use (or fewer if OMP_NUM_THREADS says so), but one on an overloaded machine.

    There a second thread mostly waits for its turn and everybody waits for it. Results do not depend on the choice.
    """
    cores = core_count()
    wish = os.environ.get("OMP_NUM_THREADS", "")
    threads = min(cores, MAX_THREADS, int(wish) if wish.isdigit() and int(wish) > 0 else cores)
    return 1 if threads > 1 and _machine_is_crowded() else threads


def _machine_is_crowded() -> bool:
    """More than 1.5 runnable tasks per core over the last minute."""
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
    """Calls a kernel on several threads at once; done when the caller's own call and all that began have returned.

    The kernel must do the whole work however few threads come.
    """

    def __init__(self) -> None:
        self._workers: list[_Worker] = []
        self._process = os.getpid()
        self._busy = _thread.allocate_lock()

    def run(self, kernel: Callable, arguments: tuple, threads: int) -> None:
        """``kernel(*arguments)`` on up to ``threads`` threads, this one included.

        A second Python thread that comes while the team is out works alone: tickets make that the same result.
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
                # Who has not woken up by now has nothing left to do: take the call back instead of waiting for a
                # busy machine to find time for it.
                called = [worker for worker in called if not worker.start.acquire(blocking=False)]
                for worker in called:
                    worker.done.acquire()
                consistent = True
            for worker in called:
                error, worker.error = worker.error, None
                if error is not None:
                    raise error
        finally:
            if not consistent:  # Ctrl-C between the locks: who knows which are held; the next call gets new workers
                self._workers = []
            self._busy.release()


TEAM = ThreadTeam()
