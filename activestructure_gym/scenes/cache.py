"""Cache arrays that are slow to compute on disk, under a name that identifies all their inputs.

The directory has a size limit: writing a file removes the least recently used ones.
"""

from __future__ import annotations

import os
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.files import UNFINISHED, replaced
from activestructure_gym.npz import read_npy
from activestructure_gym.owners import guard, open_own

try:
    import fcntl
except ImportError:  # Windows, where an open file cannot be removed anyway
    fcntl = None  # type: ignore[assignment]

# Part of every key; increase it when the meaning of any cached array changes.
CACHE_VERSION = 4
DEFAULT_LIMIT = 4 << 30  # bytes: 1200 apartments, or 20 scenes with the views of the protocol `activegamer`

_LOCAL_HEADER = 30  # bytes of an entry in a zip file before its name
_SIZE = re.compile(r"(\d{1,12}(?:\.\d{1,6})?) *([kmgt]?)i?b?", re.IGNORECASE)
_ABANDONED = 3600.0  # seconds: an older temporary file was left by a killed process


def cache_directory() -> Path:
    """Return the folder of the cache: ``$ASG_CACHE_DIR``, or ``~/.cache/activestructure_gym``."""
    return Path(os.path.expanduser(os.environ.get("ASG_CACHE_DIR") or "~/.cache/activestructure_gym"))


def cache_limit() -> int:  # bytes
    """Return the size limit of the cache in bytes: ``$ASG_CACHE_MAX``, or 4 GiB.

    The variable is a text such as ``500MB`` or ``2GB``; 0 keeps nothing. Raises `InputError` for another form.
    """
    given = os.environ.get("ASG_CACHE_MAX", "")
    if not given:
        return DEFAULT_LIMIT
    found = _SIZE.fullmatch(given.strip())
    if not found:
        raise InputError(f"ASG_CACHE_MAX is a size such as 500MB or 2GB, or 0 to keep nothing, got {short_repr(given)}")
    return int(float(found[1]) * 1024 ** " kmgt".index(found[2].lower() or " "))


def cache_files() -> list[tuple[Path, int]]:
    """Return the cached files and their sizes in bytes, least recently used first."""
    found = []
    with suppress(OSError):
        for entry in os.scandir(cache_directory()):
            with suppress(OSError):  # removed by another process in the meantime
                if entry.name.endswith(".npz") and entry.is_file(follow_symlinks=False):
                    state = entry.stat()
                    found.append((state.st_mtime_ns, Path(entry.path), state.st_size))
    return [(file, size) for _, file, size in sorted(found)]


def clear_cache(limit: int = 0) -> tuple[int, int]:
    """Remove the least recently used files until ``limit`` bytes are left; return the removed number and bytes.

    Files that a process is reading or writing are kept.
    """
    files = cache_files()
    excess = sum(size for _, size in files) - limit
    count, gone = 0, 0
    for file, size in files:
        if gone >= excess:
            break
        with suppress(OSError), _open_alone(file) as alone:
            if alone:
                file.unlink()
                count, gone = count + 1, gone + size
    for part in _abandoned():
        with suppress(OSError):
            part.unlink()
    return count, gone


def cached_arrays(
    key: str, compute: Callable[[], dict[str, np.ndarray]], layout: Mapping[str, tuple[str, int]] | None = None
) -> dict[str, np.ndarray]:
    """Return the arrays of ``compute()``, from disk if they are cached under ``key``.

    Files are uncompressed: decompressing a scene's reference views takes longer than evaluating a map against some of
    them. Processes may compute the same key at once; each writes its own temporary file and renames it, so readers
    never see a partial file. The arrays are computed again if the file is damaged, if another user may have written
    it, or if it lacks an array of ``layout`` (name -> dtype, number of axes). Without a writable directory they are
    computed every time.
    """
    file = cache_directory() / f"{key}-v{CACHE_VERSION}.npz"
    arrays = _read(file)
    if arrays is None or not _fits(arrays, layout or {}):
        arrays = compute()
        _write(file, arrays)
    return arrays


def _fits(arrays: Mapping[str, np.ndarray], layout: Mapping[str, tuple[str, int]]) -> bool:
    return all(
        name in arrays and arrays[name].dtype == np.dtype(dtype) and arrays[name].ndim == axes
        for name, (dtype, axes) in layout.items()
    )


def _read(file: Path) -> dict[str, np.ndarray] | None:
    try:
        with open_own(file) as stream, zipfile.ZipFile(stream) as archive:
            if fcntl is not None:
                fcntl.flock(stream, fcntl.LOCK_SH)  # see `clear_cache`
            arrays = {name.removesuffix(".npy"): array for name, array in _members(stream, archive)}
            with suppress(OSError):
                os.utime(file)  # last use; few file systems record the access time
    except Exception:  # missing or damaged: zipfile and numpy's header parser raise many types
        return None  # computed again and overwritten
    return arrays


def _members(stream: IO[bytes], archive: zipfile.ZipFile) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the names and arrays of an uncompressed npz file; raise `ValueError` for a damaged file.

    The arrays are read directly from the stream, since reading them with zipfile takes ten times as long. Each array is
    compared with its CRC-32 in the zip file. The entries must be contiguous up to the central directory, so that none
    is missing.
    """
    place = 0
    for entry in archive.infolist():
        stream.seek(place)
        header = stream.read(_LOCAL_HEADER)
        if entry.header_offset != place or len(header) < _LOCAL_HEADER or not header.startswith(b"PK\x03\x04"):
            raise ValueError("no local header of a zip file where one should be")
        name, extra = struct.unpack_from("<HH", header, 26)
        if stream.read(name) != entry.filename.encode():
            raise ValueError("the name of an array is not the same in both places")
        start = place + _LOCAL_HEADER + name + extra
        place = start + entry.file_size
        if place > archive.start_dir:
            raise ValueError("the file ends before the array")
        stream.seek(start)
        array = read_npy(stream, entry.filename, entry.file_size)
        stream.seek(start)
        checksum = zlib.crc32(stream.read(entry.file_size - array.nbytes))
        if array.size:
            checksum = zlib.crc32(array.reshape(-1, order="A").view(np.uint8).data, checksum)
        if checksum != entry.CRC:
            raise ValueError("the checksum is another one")
        yield entry.filename, array
    if place != archive.start_dir:
        raise ValueError("an array is missing")


def _write(file: Path, arrays: dict[str, np.ndarray]) -> None:
    limit = cache_limit()
    if not limit:
        return
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with replaced(file) as stream:
            guard(stream.fileno())
            np.savez(stream, **arrays)  # type: ignore[arg-type]
    except OSError:  # read-only or full disk: the cache is optional
        return
    with suppress(OSError), _being_read(file):
        clear_cache(limit)


@contextmanager
def _being_read(file: Path) -> Iterator[None]:
    """Keep other processes from removing the file during the block."""
    with open(file, "rb") as stream:
        if fcntl is not None:
            fcntl.flock(stream, fcntl.LOCK_SH)
        yield


@contextmanager
def _open_alone(file: Path) -> Iterator[bool]:
    """Yield True if no process is reading the file, and keep processes from starting to read it during the block."""
    with open(file, "rb") as stream:
        try:
            if fcntl is not None:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True


def _abandoned() -> list[Path]:
    old = time.time() - _ABANDONED
    with suppress(OSError):
        return [file for file in cache_directory().glob(UNFINISHED) if file.stat().st_mtime < old]
    return []
