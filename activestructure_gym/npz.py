"""Read and write arrays in npz files; files to read may be damaged or hostile.

An npz file is a zip of npy files. Both formats state sizes before the data, and these may be false. Nothing is
unpickled, and no memory is allocated beyond what the bytes on disk can hold.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

MAX_BYTES = 1 << 30  # default limit on the bytes of all arrays of a file together
# Deflate compresses zeros 1000 times; real arrays (images, masks) about 10 times.
_RATIO, _SMALL = 200, 64 << 20  # largest believed compression ratio, for files whose arrays take more than _SMALL bytes
_MAX_ARRAYS = 1000


def read_npz(path: str | os.PathLike[str], largest: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Return all arrays of the file by name, ``largest`` bytes together at most.

    Raises OSError if the file cannot be opened, and ValueError with the reason for any other fault.
    """
    if Path(path).exists() and not Path(path).is_file():  # reading a pipe or a device might not end
        raise ValueError("it is not a regular file")
    with open(path, "rb") as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                entries = archive.infolist()
                _check_sizes(entries, os.fstat(stream.fileno()).st_size, largest)
                return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
        except Exception as error:  # zipfile, zlib and numpy's header parser raise many types
            raise ValueError(" ".join(str(error).split())[:200] or "it is not an npz file") from error


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays compressed, or uncompressed if they would compress beyond what `read_npz` accepts."""
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    if sum(array.nbytes for array in arrays.values()) > _SMALL // 2 + _RATIO * os.path.getsize(path):
        with open(path, "wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]


def _check_sizes(entries: list[zipfile.ZipInfo], size: int, largest: int) -> None:
    if len(entries) > _MAX_ARRAYS:
        raise ValueError(f"it holds {len(entries)} arrays, at most {_MAX_ARRAYS} are read")
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > largest:
        raise ValueError(f"its arrays take {unpacked:,} bytes, at most {largest:,} are read")
    if unpacked > _SMALL + _RATIO * size:
        raise ValueError(f"its {size:,} bytes unpack to {unpacked:,}, more than {_RATIO} times as many")


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(entry) as stream:
        array = read_npy(stream, entry.filename, entry.file_size)
        if stream.read(1):  # reading to the end verifies the checksum
            raise ValueError(f"'{entry.filename}' is cut off")
    return array


def read_npy(stream: Any, name: str, size: int) -> np.ndarray:
    """Return the array stored as npy in the next ``size`` bytes of a stream. Raises whatever numpy's parser raises."""
    start = stream.tell()
    version = npy.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = npy.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = npy.read_array_header_2_0(stream)
    else:
        raise ValueError(f"'{name}' has the npy version {version}")
    if dtype.hasobject:
        raise ValueError(f"'{name}' holds Python objects, which are never unpickled (allow_pickle)")
    count = math.prod(shape) * dtype.itemsize
    if count != start + size - stream.tell():
        raise ValueError(f"'{name}' does not have the size given in its header")
    content = np.empty(count, np.uint8)
    if stream.readinto(memoryview(content)) != count:  # type: ignore[arg-type]
        raise ValueError(f"'{name}' is cut off")
    if not count:
        return np.zeros(shape, dtype)
    return content.view(dtype).reshape(shape, order="F" if fortran else "C")
