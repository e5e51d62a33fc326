"""Keep the machine code of kernels on disk: one file per kernel and signature, with a stamp and a checksum.

The stamp is a hash over the source files that the kernel depends on (`stamps`). A file with another stamp, from other
versions, for another processor, or damaged by a single bit counts as missing: the kernel is compiled again. So does a
file that another user can have written (`activestructure_gym.owners`), because loading it runs its content. numba's own
cache files have no checksum, and numba detects changes of the kernel's own source file only.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import pickle
import sys
import warnings
from glob import glob
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.serialize import dumps

from activestructure_gym.compiling.stamps import stamp_of
from activestructure_gym.files import replaced
from activestructure_gym.owners import folder_of_others, guard, open_own

SUFFIX = ".kernel"
_HEAD = b"activestructure_gym kernel 2\n"  # first bytes of every file, with the version of the format
_STAMP = 32  # bytes of the stamp, and also of the checksum
# Options of numba for all kernels.
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_VERSIONS = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)

not_kept: list[str] = []  # reasons why this process cannot keep kernels on disk; empty if it can


class KernelCache(FunctionCache):
    """Replace the cache files of numba for one kernel; raise RuntimeError if none can be kept."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._source = function.__code__.co_filename
        self._cache_file: Any = self  # numba's Cache calls load, save and flush of its attribute of this name
        place = Path(self.cache_path)
        if place.name != "__pycache__":  # numba has created the folder with default permissions
            guard(place)
        root = Path(getattr(numba.config, "CACHE_DIR", "") or place)
        folders = [place, *(above for above in place.parents if above.is_relative_to(root))]
        if others := folder_of_others(folders, self._source):
            raise RuntimeError(f"other users can write into the folder '{others}'")

    def holds(self, signature: Any, codegen: Any) -> bool:
        """Return whether the machine code for a signature is on disk, valid and undamaged."""
        return self.load(self._index_key(signature, codegen)) is not None

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Path, bytes | None, Any]:
        """Return the path of a signature's file, its stamp, and the signature.

        The stamp is None if the machine code must not be kept on disk.
        """
        fits = (str(signature), _fields(signature), codegen.magic_tuple(), _VERSIONS, OPTIONS)
        digest = hashlib.sha256(repr(fits).encode()).hexdigest()[:12]
        path = Path(self.cache_path) / f"{self._impl.filename_base}.{digest}{SUFFIX}"
        # numba names a function passed as an argument by its memory address, which is valid in this process only. The
        # stamp is computed at the first use, because a function may call functions that are defined after it.
        return path, None if " at 0x" in str(signature) else stamp_of(self._py_func), signature

    def _load_overload(self, signature: Any, target_context: Any) -> Any:
        try:
            return super()._load_overload(signature, target_context)
        except Exception:  # the file is intact but cannot be used; the kernel is compiled instead
            return None

    def load(self, key: tuple[Path, bytes | None, Any]) -> Any:
        """Return numba's data of a compiled function; None if it has to be compiled. ``key`` is from `_index_key`."""
        path, stamp, asked = key
        content = read(path, stamp, self._source) if stamp is not None else None
        signature, data = pickle.loads(content) if content is not None else (None, None)
        return data if signature == asked else None

    def save(self, key: tuple[Path, bytes | None, Any], data: Any) -> None:
        """Write numba's data of a compiled function; raise OSError if that fails. ``key`` is from `_index_key`."""
        path, stamp, signature = key
        if stamp is not None:
            write(path, stamp, dumps((signature, data)))

    def flush(self) -> None:
        """Remove all files of this kernel."""
        for path in Path(self.cache_path).glob(f"{self._impl.filename_base}.*{SUFFIX}"):
            path.unlink(missing_ok=True)


def read(path: Path, stamp: bytes | None = None, source: str = __file__) -> bytes | None:
    """Return the content of a kernel file; None if it is missing, damaged or writable by other users.

    It is also None if its stamp differs from ``stamp``; without ``stamp`` every stamp is accepted. Users who can write
    the file ``source`` may also write kernel files.
    """
    try:
        with open_own(path, source) as file:
            everything = file.read()
    except OSError:
        return None
    begin, end = len(_HEAD), len(_HEAD) + 2 * _STAMP
    head, content = everything[:end], everything[end:]
    return content if head == _head(stamp or head[begin : begin + _STAMP], content) else None


def write(path: Path, stamp: bytes, content: bytes) -> None:
    """Write a kernel file with its stamp and checksum, completely or not at all."""
    with replaced(path) as file:
        guard(file.fileno())
        file.write(_head(stamp, content) + content)


def _head(stamp: bytes, content: bytes) -> bytes:
    return _HEAD + stamp + hashlib.sha256(stamp + content).digest()


def _fields(kind: Any) -> str:
    """Return the field names of the named tuples among argument types, which numba's names of the types omit.

    ``kind`` is a numba type or a tuple of numba types.
    """
    if isinstance(kind, tuple):
        return ",".join(filter(None, map(_fields, kind)))
    inner = getattr(kind, "types", None) or getattr(kind, "dtype", None)
    fields = f"{kind}{kind.fields}" if hasattr(kind, "instance_class") else ""
    return fields + (_fields(inner) if isinstance(inner, (tuple, numba.types.Type)) and inner is not kind else "")


def cache_place() -> Path | None:
    """Return the folder chosen by numba for the kernels of this package; None if kernels cannot be kept."""
    try:
        return Path(KernelCache(cache_place).cache_path)
    except RuntimeError:
        return None


def kernel_files() -> list[Path]:
    """Return the cache files of all kernels of this installation, including damaged ones."""
    place = cache_place()
    if place is None:
        return []
    # Kernel files are next to the sources, or all in one folder.
    root = Path(__file__).parents[1] if place.name == "__pycache__" else place.parent
    return sorted(root / name for name in glob(f"**/*{SUFFIX}", root_dir=root, recursive=True))  # follows links


def warn_of_no_cache(reason: str) -> None:
    """Warn once per process that compiled kernels cannot be kept, and name the remedy."""
    if not not_kept and multiprocessing.parent_process() is None:
        warnings.warn(
            f"compiled kernels cannot be kept ({reason}), so every process compiles them again; "
            "set the environment variable NUMBA_CACHE_DIR to a directory that you alone can write",
            stacklevel=4,
        )
    not_kept.append(reason)
