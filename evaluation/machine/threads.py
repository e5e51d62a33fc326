"""Limit the number of threads of this process and of the processes that it starts."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from activestructure_gym.cores import core_count

# Environment variables for the number of threads; OpenMP, MKL, OpenBLAS and numba read theirs once, when loaded.
_COUNT_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def thread_cap() -> int:
    """Return the number of threads that one call may use: ``OMP_NUM_THREADS`` if set, else one per core."""
    text = os.environ.get("OMP_NUM_THREADS", "")
    return int(text) if text.isdigit() and int(text) > 0 else core_count()


def set_passive_waiting() -> None:
    """Make idle OpenMP threads sleep instead of spin. Call this before torch is imported.

    With spinning threads, two torch processes with two threads each took 35 times as long on two cores
    (docs/notebook/lab_notes.md).
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def worker_environment(slots: int) -> dict[str, str]:
    """Return the environment variables for one of ``slots`` parallel processes, which share the cores equally."""
    return capped_environment(core_count() // max(1, slots))


def capped_environment(threads: int) -> dict[str, str]:
    """Return this process's environment variables, changed for a process with ``threads`` threads, at least 1."""
    environment = dict(os.environ)
    environment.update({name: str(max(1, threads)) for name in _COUNT_VARIABLES})
    environment["OMP_WAIT_POLICY"] = "PASSIVE"
    environment["MPLBACKEND"] = "Agg"
    environment["PYTHONSAFEPATH"] = "1"  # keeps the working directory out of sys.path, as in this process
    return environment


@contextmanager
def single_threaded_children() -> Iterator[None]:
    """Set environment variables during the ``with`` block by which processes started in it use one thread each."""
    before = dict(os.environ)
    os.environ.update(capped_environment(1))
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
