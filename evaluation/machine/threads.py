"""Numbers of threads: of this process, and in the environment of those it starts."""

from __future__ import annotations

import os

from activestructure_gym.cores import core_count

# Libraries read their own variable, once, when they are loaded.
_COUNT_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def thread_cap() -> int:
    """Threads one call may use: ``OMP_NUM_THREADS`` where it is set, else one per core."""
    text = os.environ.get("OMP_NUM_THREADS", "")
    return int(text) if text.isdigit() and int(text) > 0 else core_count()


def set_passive_waiting() -> None:
    """Let idle OpenMP threads sleep instead of spin; call before torch is imported.

    Two torch processes of two threads on two cores ran 35 times slower with spinning threads
    (docs/notebook/groundwork.md).
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def worker_environment(slots: int) -> dict[str, str]:
    """The environment for one of ``slots`` processes that run at the same time: the cores are shared out evenly."""
    return capped_environment(core_count() // max(1, slots))


def capped_environment(threads: int) -> dict[str, str]:
    """The environment for a process of so many threads, at least one."""
    environment = dict(os.environ)
    environment.update({name: str(max(1, threads)) for name in _COUNT_VARIABLES})
    environment["OMP_WAIT_POLICY"] = "PASSIVE"
    environment["MPLBACKEND"] = "Agg"
    environment["PYTHONSAFEPATH"] = "1"  # it finds modules as this process does, and not first in the working directory
    return environment
