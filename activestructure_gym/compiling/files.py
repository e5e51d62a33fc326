"""The machine code of kernels on disk: a file per kernel and signature, which begins with what it must fit and a sum.

A file is read as a whole before any of it is used. If it was made from other sources, for another processor or by other
versions, or if a single bit of it is not what was written, it counts as not being there, and the kernel is compiled and
the file written anew. (numba's own cache has no checksums: damaged machine code would be run.) So does a file that
another user can have written (`activestructure_gym.owners`): loading it runs what is in it.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import pickle
import sys
import warnings
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl
from numba.core.serialize import dumps

from activestructure_gym.compiling.stamps import stamp_of
from activestructure_gym.files import replaced
from activestructure_gym.owners import folder_of_others, guard, open_own

SUFFIX = ".kernel"
_HEAD = b"activestructure_gym kernel 2\n"
_STAMP = 32  # bytes; so many has the checksum, too
_VERSIONS = (numba.__version__, llvmlite.__version__, np.__version__, sys.version)

not_kept: list[str] = []  # why the kernels of this process are not kept, where they are not


class OthersFolder(RuntimeError):
    """Kernels would be kept in a folder that other users can write."""


class KernelFiles:
    """numba's cache interface for the machine code of one kernel; raises RuntimeError where none can be kept.

    The stamp is not computed before the first question: a function may call what is defined after it.
    """

    def __init__(self, function: Any) -> None:
        self._function = function
        self._form = CompileResultCacheImpl(function)  # how numba names, writes and reads a compiled function
        self._enabled = True
        self._source = function.__code__.co_filename
        place = Path(self.cache_path)
        if place.name != "__pycache__":  # numba has made it, and for everybody where the umask says so
            guard(place)
        if others := folder_of_others(_folders(place), self._source):
            raise OthersFolder(f"other users can write into the folder '{others}'")

    @property
    def cache_path(self) -> str:
        """The directory of the files."""
        path: str = self._form.locator.get_cache_path()
        return path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for a signature; None where it has to be compiled."""
        target_context.refresh()
        stamp = self._stamp(sig)
        if stamp is None:
            return None
        content = read(self._path(sig, target_context.codegen()), stamp, self._source)
        if content is None:
            return None
        try:
            signature, compiled = pickle.loads(content)
            return self._form.rebuild(target_context, compiled) if signature == sig else None
        except Exception:  # whole, and from the same versions, and yet of no use: whatever it is, compiling helps
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function; raises OSError where that cannot be done."""
        stamp = self._stamp(sig)
        if stamp is None or not self._form.check_cachable(data):
            return
        self._form.locator.ensure_cache_path()
        write(self._path(sig, data.codegen), stamp, dumps((sig, self._form.reduce(data))))

    def _stamp(self, signature: Any) -> bytes | None:
        """The stamp for a signature; None where the machine code must not be shared with other processes."""
        one_process_only = " at 0x" in str(signature)  # a function as an argument: numba names its type by its address
        return stamp_of(self._function) if self._enabled and not one_process_only else None

    def _path(self, signature: Any, codegen: Any) -> Path:
        """Return the file of a signature: one per signature, processor and versions."""
        fits = (str(signature), _fields(signature), codegen.magic_tuple(), _VERSIONS)
        name = hashlib.sha256(repr(fits).encode()).hexdigest()[:12]
        return Path(self.cache_path) / f"{self._form.filename_base}.{name}{SUFFIX}"

    def enable(self) -> None:
        """Read and write files."""
        self._enabled = True

    def disable(self) -> None:
        """Neither read nor write files."""
        self._enabled = False

    def flush(self) -> None:
        """Remove the files of this kernel."""
        for file in Path(self.cache_path).glob(f"{self._form.filename_base}.*{SUFFIX}"):
            file.unlink(missing_ok=True)


def read(path: Path, stamp: bytes, source: str = __file__) -> bytes | None:
    """The content of a file with this stamp; None if it is missing, damaged, or not guarded like ``source``."""
    head, content = _split(path, source)
    return content if head == _head(stamp, content) else None


def write(path: Path, stamp: bytes, content: bytes) -> None:
    """Write the file whole or not at all."""
    with replaced(path) as file:
        guard(file.fileno())
        file.write(_head(stamp, content) + content)


def is_whole(path: Path) -> bool:
    """Whether the checksum of a file is right, whatever its stamp."""
    head, content = _split(path)
    return head == _head(head[len(_HEAD) : len(_HEAD) + _STAMP], content)


def _split(path: Path, source: str = __file__) -> tuple[bytes, bytes]:
    try:
        with open_own(path, source) as file:
            everything = file.read()
    except OSError:
        return b"", b""
    end = len(_HEAD) + 2 * _STAMP
    return everything[:end], everything[end:]


def _head(stamp: bytes, content: bytes) -> bytes:
    return _HEAD + stamp + hashlib.sha256(stamp + content).digest()


def _fields(kind: Any) -> str:
    """The fields of named tuples among argument types, in order: their types' names do not say them."""
    if isinstance(kind, tuple):
        return ",".join(filter(None, map(_fields, kind)))
    inner = getattr(kind, "types", None) or getattr(kind, "dtype", None)
    fields = f"{kind}{kind.fields}" if hasattr(kind, "instance_class") else ""
    return fields + (_fields(inner) if isinstance(inner, (tuple, numba.types.Type)) and inner is not kind else "")


def _folders(place: Path) -> list[Path]:
    """The folder of a kernel's files and those above it up to ``NUMBA_CACHE_DIR``, where that is set."""
    above, root = [place, *place.parents], Path(getattr(numba.config, "CACHE_DIR", "") or place)
    return above[: above.index(root) + 1] if root in above else [place]


def cache_place() -> Path | None:
    """The directory of this room's kernels, where numba puts it; None where they cannot be kept."""

    def probe() -> None: ...

    try:
        return Path(KernelFiles(probe).cache_path)
    except RuntimeError:
        return None


def package_folders() -> list[Path]:
    """Return the folders of this package's code; in a checkout the links in the first lead to the others."""
    package = Path(__file__).resolve().parents[1]
    return [package, *((package / room).resolve() for room in ("envs", "policies", "evaluation"))]


def kernel_files() -> list[Path]:
    """Return all cache files of this installation's kernels, damaged or not."""
    place = cache_place()
    if place is None:
        return []
    roots = package_folders() if place.name == "__pycache__" else [place.parent]  # beside the sources, or all in one
    return sorted({file for root in roots for file in root.rglob(f"*{SUFFIX}")})


def warn_of_no_cache(reason: str) -> None:
    """Warn once per process that compiled kernels cannot be kept, with the remedy."""
    if not not_kept and multiprocessing.parent_process() is None:
        warnings.warn(
            f"compiled kernels cannot be kept ({reason}), so every process compiles them again; "
            "set the environment variable NUMBA_CACHE_DIR to a directory that you alone can write",
            stacklevel=4,
        )
    not_kept.append(reason)
