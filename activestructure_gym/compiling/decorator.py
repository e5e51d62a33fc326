"""Define `kernel`, the decorator of all compiled functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from numba import config, njit
from numba.core.compiler_lock import global_compiler_lock

from activestructure_gym.compiling.ahead import start_helpers
from activestructure_gym.compiling.files import OPTIONS, KernelCache, warn_of_no_cache
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.compiling.progress import PROGRESS
from activestructure_gym.errors import InputError

PROGRESS.call_for_help = start_helpers


def kernel(function: Callable[..., Any]) -> Any:
    """Return a function that numba compiles at its first call and whose machine code is kept on disk.

    Kernels run without Python's global interpreter lock (GIL). Division by zero gives infinity or NaN, as in numpy. If
    kernels cannot be kept on disk, every process compiles them, and one warning names the remedy.

    Parameters
    ----------
    function : callable
        A function that numba can compile. It may call other kernels.

    Returns
    -------
    callable
        numba's dispatcher of the function. Under ``NUMBA_DISABLE_JIT`` its calls raise `InputError`.
    """
    dispatcher: Any = njit(**OPTIONS)(function)
    if not hasattr(dispatcher, "compile"):
        return wraps(function)(lambda *_, **__: check_compiling())
    try:
        dispatcher._cache = KernelCache(dispatcher.py_func)  # as numba's own ``enable_caching`` does with its cache
    except RuntimeError as error:
        warn_of_no_cache(str(error))
    name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
    compile_or_load = dispatcher.compile

    def compile_or_load_alone(signature: Any) -> Any:
        # numba nests its lock between threads outside the lock between processes. This order is kept, because two
        # processes could otherwise deadlock.
        with global_compiler_lock, PROGRESS.around(name), LOCKS.held(name, PROGRESS.report):
            try:
                return compile_or_load(signature)
            except OSError as error:  # the disk or a quota is full
                warn_of_no_cache(str(error))
                return compile_or_load(signature)  # the machine code is in memory

    dispatcher.compile = compile_or_load_alone  # numba calls it for every signature without machine code
    return dispatcher


def check_compiling() -> None:
    """Raise `InputError` if the environment forbids numba to compile.

    Raises
    ------
    InputError
        If the environment sets ``NUMBA_DISABLE_JIT``.
    """
    if getattr(config, "DISABLE_JIT", 0):
        raise InputError(
            "NUMBA_DISABLE_JIT is set, and the kernels cannot run as Python: they need atomic instructions. Unset it"
        )
