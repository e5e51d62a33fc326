"""Calls spread over spawned processes of one thread each, which end when this process does."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.threads import capped_environment


def spread(function: Callable[..., Any], calls: Sequence[tuple[Any, ...]], workers: int) -> Iterator[int]:
    """Make all calls, here for one worker, else in as many processes; yields how many are made. Errors are raised.

    After an error, Ctrl-C included, no call is played to its end: what they write are whole files or none.
    """
    if workers <= 1 or len(calls) <= 1:
        for done, call in enumerate(calls, start=1):
            function(*call)
            yield done
        return
    with single_threaded_children():
        # Never forked: a child forked from a process that used numba's or torch's threads hangs.
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
            # Those that wait in the pool's own queue cannot be cancelled, and would be made, too.
            for process in list(pool._processes.values()):  # which has no other name before Python 3.14
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def single_threaded_children() -> Iterator[None]:
    """Processes that are started in the block use one thread each; libraries read that from their environment."""
    before = dict(os.environ)
    os.environ.update(capped_environment(1))
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def one_thread() -> None:
    """OpenCV reads no environment variable: it is told, in every process."""
    import cv2

    cv2.setNumThreads(1)


def follow_parent() -> None:
    """End this process when its parent does, however that ends: a pool's own pipes stay open among its workers.

    Ctrl-C, which every process of a terminal gets, is the parent's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    one_thread()
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)  # nobody waits for the result
