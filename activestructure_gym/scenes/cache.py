"""Arrays that are slow to compute, kept on disk under a name that says all they depend on."""

from __future__ import annotations

import os
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib.format import read_array

# Part of every key: raise it when the meaning of any cached array changes.
CACHE_VERSION = 2

_LOCAL_HEADER = 30  # bytes before the name of a zip file's entry


def cache_directory() -> Path:
    """``$ASG_CACHE_DIR``, or ``~/.cache/activestructure_gym``."""
    given = os.environ.get("ASG_CACHE_DIR")
    return Path(given) if given else Path(os.path.expanduser("~/.cache/activestructure_gym"))


def cached_arrays(key: str, compute: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """What ``compute`` returns, from disk where it has been computed before.

    Kept uncompressed: unpacking the true views of a scene takes longer than measuring a map against some of them.
    Two processes may compute the same key at once; each writes a file of its own and moves it into place, so a
    reader sees nothing or everything. Without a writable directory the result is computed every time.
    """
    file = cache_directory() / f"{key}-v{CACHE_VERSION}.npz"
    arrays = _read(file)
    if arrays is None:
        arrays = compute()
        _write(file, arrays)
    return arrays


def _read(file: Path) -> dict[str, np.ndarray] | None:
    try:
        with open(file, "rb") as stream, zipfile.ZipFile(stream) as archive:
            entries = archive.infolist()
            packed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
            arrays = {entry.filename.removesuffix(".npy"): _member(stream, archive, entry) for entry in entries}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error):
        return None  # not there, or damaged: computed again and overwritten
    if packed:
        _write(file, arrays)  # as older versions kept it
    return arrays


def _member(stream: IO[bytes], archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """One array of an npz file, past zipfile's copies and checksums where it is stored as it is.

    A file is written whole or not at all, so nothing is lost with the checksum; its length is checked.
    """
    if entry.compress_type != zipfile.ZIP_STORED:
        with archive.open(entry) as packed:
            return read_array(packed, allow_pickle=False)
    stream.seek(entry.header_offset)
    header = stream.read(_LOCAL_HEADER)
    if len(header) < _LOCAL_HEADER or not header.startswith(b"PK\x03\x04"):
        raise ValueError("no local header of a zip file")
    start = entry.header_offset + _LOCAL_HEADER + sum(struct.unpack_from("<HH", header, 26))  # name and extra field
    stream.seek(start)
    array = read_array(stream, allow_pickle=False)
    if stream.tell() != start + entry.file_size:
        raise ValueError("the array does not fill its place in the file")
    return array


def _write(file: Path, arrays: dict[str, np.ndarray]) -> None:
    temporary = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=file.stem, suffix=".part", delete=False) as stream:
            temporary = stream.name
            np.savez(stream, **arrays)  # type: ignore[arg-type]
        os.replace(temporary, file)
    except OSError:  # read-only or full disk: the cache is a convenience
        if temporary is not None:
            try:
                os.unlink(temporary)
            except OSError:
                pass
