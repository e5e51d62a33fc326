"""Compile kernels once per installation, in one process at a time, and again when their source has changed.

A kernel is a Python function that numba compiles to machine code at its first call. The decorator `kernel` keeps the
machine code on disk: next to the source, or in the user's cache folder where the package cannot be written, or in
``NUMBA_CACHE_DIR``. It replaces numba's ``cache=True``:

- `stamps`: machine code is used until a file changes that the kernel depends on.
- `files`: machine code is stored with a checksum; a damaged file is not run, and its kernel is compiled again.
- `locks`: of several processes, one compiles a kernel; the others wait and load its file.
- `ahead`: helper processes compile the kernels that will be needed next.
- `progress`: standard error shows how many kernels are compiled.

`thread_team` calls a kernel on several threads at once.
"""

from activestructure_gym.compiling.decorator import check_compiling, kernel
from activestructure_gym.compiling.files import cache_place
from activestructure_gym.compiling.progress import describe, told_to

__all__ = ["cache_place", "check_compiling", "describe", "kernel", "told_to"]
