"""Distribute function calls over processes with one thread each, which end when this process ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import parent_process
from multiprocessing.context import BaseContext
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.threads import single_threaded_children

_PRELOADED = ["activestructure_gym.envs.preload", "activestructure_gym.evaluation.training.demonstrations"]


def worker_context(*modules: str) -> BaseContext:
    """Return how worker processes are started: forked from a server that has imported everything and run nothing.

    The server also imports ``modules``. A fork of this process itself would hang if it has used threads of numba or
    torch. Processes are spawned where the system has no forkserver.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*_PRELOADED, *modules])  # without effect once the server runs
    return context


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
        pool = ProcessPoolExecutor(min(workers, len(calls)), worker_context(), initializer=follow_parent)
        try:
            waiting = [pool.submit(function, *call) for call in calls]
            for done, future in enumerate(as_completed(waiting), start=1):
                future.result()
                yield done
        except BaseException as error:
            # Calls that are in the pool's queue already cannot be cancelled, and a broken pool can miss a process that
            # it was starting, so the processes are ended.
            for process in list(pool._processes.values()):  # public only from Python 3.14 on
                process.terminate()
            if isinstance(error, BrokenProcessPool):
                raise InputError(
                    "a worker process was killed, perhaps because memory ran out: use fewer --workers"
                ) from error
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
