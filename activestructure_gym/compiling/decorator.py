"""The decorator of all kernels."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

from numba import config, njit
from numba.core.compiler_lock import global_compiler_lock

from activestructure_gym.compiling.ahead import start_helper
from activestructure_gym.compiling.files import KernelFiles, OthersFolder, warn_of_no_cache
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.compiling.progress import PROGRESS
from activestructure_gym.errors import InputError

PROGRESS.call_for_help = start_helper


def kernel(function: Callable[..., Any]) -> Any:
    """Compile for use from Python: kept on disk, without the GIL, dividing by zero as numpy does.

    Where nothing can be kept, the kernel is compiled by every process, and one warning names the remedy. Where
    ``NUMBA_DISABLE_JIT`` forbids compiling, calling the kernel raises `InputError`.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    dispatcher: Any = njit(**options)(function)
    if not hasattr(dispatcher, "compile"):
        return _uncompiled(function)
    try:
        dispatcher._cache = KernelFiles(dispatcher.py_func)  # as numba's own ``enable_caching`` does with its cache
    except OthersFolder as error:
        warn_of_no_cache(str(error))
    except RuntimeError:  # numba found no place that can be written
        warn_of_no_cache("no directory for them can be written")
    name = name_of(dispatcher)
    compile_or_load = dispatcher.compile

    def compile_or_load_alone(signature: Any) -> Any:
        # The lock between threads first, as numba itself nests it: otherwise two processes could each hold what a
        # thread of the other waits for.
        with (
            global_compiler_lock,
            PROGRESS.around(name),
            LOCKS.held(name, PROGRESS.waiting),
            _uncollected(),
        ):
            try:
                return compile_or_load(signature)
            except OSError as error:  # disk full, or a quota
                warn_of_no_cache(str(error))
                return compile_or_load(signature)  # in memory by then

    dispatcher.compile = compile_or_load_alone  # numba calls it for every signature it has no machine code for
    return dispatcher


def _uncompiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return what stands for a kernel where numba compiles nothing: a refusal."""

    @wraps(function)
    def refuse(*arguments: Any, **named: Any) -> Any:
        check_compiling()

    return refuse


def check_compiling() -> None:
    """Raise `InputError` where the environment forbids numba to compile."""
    if getattr(config, "DISABLE_JIT", 0):
        raise InputError(
            "NUMBA_DISABLE_JIT is set, and the kernels cannot run as Python: they need atomic instructions. Unset it"
        )


def name_of(kernel: Any) -> str:
    """Name of a kernel, the same in all processes."""
    return f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"


@contextmanager
def _uncollected() -> Iterator[None]:
    """While the block runs no garbage is collected, which saves a twentieth of the time of compiling."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
