"""Kernels: compiled once per installation, by one process at a time, and again when their source has changed.

numba compiles a function when it is first called. `kernel` keeps the machine code: beside the source, or in the user's
cache directory where the package cannot be written, or where ``NUMBA_CACHE_DIR`` says. What numba itself would do for a
function with ``cache=True`` is done here in four other ways; all of it comes into play only where a kernel is not in
memory yet.

- `stamps`: machine code is used as long as no file has changed that the kernel depends on.
- `files`: it is kept with a checksum, so that a damaged file is compiled again and not run.
- `locks`: of processes that start together, one compiles a kernel and the others load what it wrote.
- `progress` says on standard error what is going on; `ahead` lets other processes compile ahead.

`thread_team` calls a kernel on several threads at once.
"""

from activestructure_gym.compiling.decorator import check_compiling, kernel
from activestructure_gym.compiling.files import cache_place
from activestructure_gym.compiling.progress import describe, told_to

__all__ = ["cache_place", "check_compiling", "describe", "kernel", "told_to"]
