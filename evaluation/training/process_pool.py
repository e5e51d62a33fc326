"""Distribute function calls over spawned processes with one thread each, which end when this process ends."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.threads import single_threaded_children


def spread(function: Callable[..., Any], calls: Sequence[tuple[Any, ...]], workers: int) -> Iterator[int]:
    """Call ``function`` with every tuple of arguments in ``calls``, and yield the number of finished calls after each.

    The calls run in ``workers`` processes, or in this process if ``workers`` is 1. The first error, or Ctrl-C, ends all
    processes at once and is raised. Therefore ``function`` must write its files atomically.
    """
    if workers <= 1 or len(calls) <= 1:
        for done, call in enumerate(calls, start=1):
            function(*call)
            yield done
        return
    with single_threaded_children():
        # Spawned, not forked: a fork of a process that has used threads of numba or torch would hang.
        pool = ProcessPoolExecutor(min(workers, len(calls)), get_context("spawn"), initializer=follow_parent)
        try:
            waiting = [pool.submit(function, *call) for call in calls]
            for done, future in enumerate(as_completed(waiting), start=1):
                future.result()
                yield done
        except BrokenProcessPool as error:
            raise InputError(
                "a worker process was killed, perhaps because memory ran out: use fewer --workers"
            ) from error
        except BaseException:
            # Calls that are in the pool's queue already cannot be cancelled, so the processes are ended.
            for process in list(pool._processes.values()):  # public only from Python 3.14 on
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def one_thread() -> None:
    """Limit OpenCV to one thread in this process; no environment variable does this."""
    import cv2

    cv2.setNumThreads(1)


def follow_parent() -> None:
    """Prepare a worker process: end it when its parent ends, ignore Ctrl-C, and use one thread in OpenCV.

    The pool does not detect a killed parent, since the workers keep its pipes open.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    one_thread()
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)  # at once: sys.exit would end only this thread
