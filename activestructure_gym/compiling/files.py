"""Keep the machine code of kernels on disk: one file per kernel and signature, with a stamp and a checksum.

A file made from other sources, by other versions, for another processor, or damaged by a single bit counts as missing:
the kernel is compiled again. So does a file that another user can have written (`activestructure_gym.owners`), because
loading it runs its content. numba's own cache files have no checksum, and only the kernel's own file makes them stale.
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
_HEAD = b"activestructure_gym kernel 2\n"
_STAMP = 32  # bytes of the stamp, and of the checksum
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}  # of numba, for all kernels
_VERSIONS = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)

not_kept: list[str] = []  # reasons why kernels of this process are not kept


class KernelCache(FunctionCache):
    """Replace the files of numba's cache for one kernel; raise RuntimeError where none can be kept."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._source = function.__code__.co_filename
        self._cache_file: Any = self  # numba's Cache calls load, save and flush of this object
        place = Path(self.cache_path)
        if place.name != "__pycache__":  # numba has created it, with the permissions of the umask
            guard(place)
        root = Path(getattr(numba.config, "CACHE_DIR", "") or place)
        folders = [place, *(above for above in place.parents if above.is_relative_to(root))]
        if others := folder_of_others(folders, self._source):
            raise RuntimeError(f"other users can write into the folder '{others}'")

    def holds(self, signature: Any, codegen: Any) -> bool:
        """Return whether the file of a signature is there, valid and undamaged."""
        return self.load(self._index_key(signature, codegen)) is not None

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Path, bytes | None, Any]:
        """Return the file of a signature and its stamp, None if other processes must not use the machine code."""
        fits = (str(signature), _fields(signature), codegen.magic_tuple(), _VERSIONS, OPTIONS)
        digest = hashlib.sha256(repr(fits).encode()).hexdigest()[:12]
        path = Path(self.cache_path) / f"{self._impl.filename_base}.{digest}{SUFFIX}"
        # numba names the type of a function as an argument by its address, which holds for this process only. The
        # stamp is computed at the first use, because a function may call functions that are defined after it.
        return path, None if " at 0x" in str(signature) else stamp_of(self._py_func), signature

    def _load_overload(self, signature: Any, target_context: Any) -> Any:
        try:
            return super()._load_overload(signature, target_context)
        except Exception:  # the file is whole and yet of no use: compiling helps, whatever the reason
            return None

    def load(self, key: tuple[Path, bytes | None, Any]) -> Any:
        """Return numba's data of a compiled function; None where it has to be compiled."""
        path, stamp, asked = key
        content = read(path, stamp, self._source) if stamp is not None else None
        signature, data = pickle.loads(content) if content is not None else (None, None)
        return data if signature == asked else None

    def save(self, key: tuple[Path, bytes | None, Any], data: Any) -> None:
        """Write numba's data of a compiled function; raise OSError where that is impossible."""
        path, stamp, signature = key
        if stamp is not None:
            write(path, stamp, dumps((signature, data)))

    def flush(self) -> None:
        """Remove the files of this kernel."""
        for path in Path(self.cache_path).glob(f"{self._impl.filename_base}.*{SUFFIX}"):
            path.unlink(missing_ok=True)


def read(path: Path, stamp: bytes | None = None, source: str = __file__) -> bytes | None:
    """Return the content of a file; None if it is missing, damaged, of another stamp, or writable by other users."""
    try:
        with open_own(path, source) as file:
            everything = file.read()
    except OSError:
        return None
    begin, end = len(_HEAD), len(_HEAD) + 2 * _STAMP
    head, content = everything[:end], everything[end:]
    return content if head == _head(stamp or head[begin : begin + _STAMP], content) else None


def write(path: Path, stamp: bytes, content: bytes) -> None:
    """Write the file completely or not at all."""
    with replaced(path) as file:
        guard(file.fileno())
        file.write(_head(stamp, content) + content)


def _head(stamp: bytes, content: bytes) -> bytes:
    return _HEAD + stamp + hashlib.sha256(stamp + content).digest()


def _fields(kind: Any) -> str:
    """Return the field names of named tuples among argument types; the names of the types lack them."""
    if isinstance(kind, tuple):
        return ",".join(filter(None, map(_fields, kind)))
    inner = getattr(kind, "types", None) or getattr(kind, "dtype", None)
    fields = f"{kind}{kind.fields}" if hasattr(kind, "instance_class") else ""
    return fields + (_fields(inner) if isinstance(inner, (tuple, numba.types.Type)) and inner is not kind else "")


def cache_place() -> Path | None:
    """Return the folder of this room's kernels, chosen by numba; None where they cannot be kept."""
    try:
        return Path(KernelCache(cache_place).cache_path)
    except RuntimeError:
        return None


def kernel_files() -> list[Path]:
    """Return all cache files of this installation's kernels, damaged or not."""
    place = cache_place()
    if place is None:
        return []
    root = Path(__file__).parents[1] if place.name == "__pycache__" else place.parent  # next to the sources, or in one
    return sorted(root / name for name in glob(f"**/*{SUFFIX}", root_dir=root, recursive=True))  # follows links


def warn_of_no_cache(reason: str) -> None:
    """Warn once per process that compiled kernels cannot be kept, with the remedy."""
    if not not_kept and multiprocessing.parent_process() is None:
        warnings.warn(
            f"compiled kernels cannot be kept ({reason}), so every process compiles them again; "
            "set the environment variable NUMBA_CACHE_DIR to a directory that you alone can write",
            stacklevel=4,
        )
    not_kept.append(reason)
