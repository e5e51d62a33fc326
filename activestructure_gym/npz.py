"""Arrays from an npz file that may be damaged or hostile.

An npz file is a zip of npy files. Both say how large they are before they are read, and either may lie: nothing is
unpickled, and nothing is allocated that the bytes on the disk do not account for.
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

LARGEST_BYTES = 1 << 30  # of all arrays of a file together, if whoever reads it says nothing else
# Deflate packs zeros a thousand times; real arrays, of images and masks, about ten times.
_RATIO, _SMALL = 200, 64 << 20  # times the file's size, above so many bytes
_MOST_ARRAYS = 1000


def read_npz(path: str | os.PathLike[str], largest: int = LARGEST_BYTES) -> dict[str, np.ndarray]:
    """All arrays of the file, ``largest`` bytes together at most.

    Raises OSError where it cannot be opened, else ValueError that says what is wrong.
    """
    if Path(path).exists() and not Path(path).is_file():  # a pipe or a device would never end
        raise ValueError("it is no regular file")
    with open(path, "rb") as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                entries = archive.infolist()
                _check_sizes(entries, os.fstat(stream.fileno()).st_size, largest)
                return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
        except Exception as error:  # zipfile, zlib and the parser of npy headers raise whatever they meet
            raise ValueError(" ".join(str(error).split())[:200] or "it is no npz file") from error


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays packed, or as they are where they would pack better than `read_npz` believes."""
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    if sum(array.nbytes for array in arrays.values()) > _SMALL // 2 + _RATIO * os.path.getsize(path):
        with open(path, "wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]


def _check_sizes(entries: list[zipfile.ZipInfo], size: int, largest: int) -> None:
    if len(entries) > _MOST_ARRAYS:
        raise ValueError(f"it holds {len(entries)} arrays, at most {_MOST_ARRAYS} are read")
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > largest:
        raise ValueError(f"its arrays take {unpacked:,} bytes, at most {largest:,} are read")
    if unpacked > _SMALL + _RATIO * size:
        raise ValueError(f"its {size:,} bytes unpack to {unpacked:,}, more than {_RATIO} times as many")


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(entry) as stream:
        array = read_npy(stream, entry.filename, entry.file_size)
        if stream.read(1):  # which checks the sum
            raise ValueError(f"'{entry.filename}' is cut off")
    return array


def read_npy(stream: Any, name: str, size: int) -> np.ndarray:
    """The array whose npy file is the next ``size`` bytes of a stream. Raises whatever numpy's parser raises."""
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
        raise ValueError(f"'{name}' does not have the size that its header says")
    content = np.empty(count, np.uint8)
    if stream.readinto(memoryview(content)) != count:  # type: ignore[arg-type]
        raise ValueError(f"'{name}' is cut off")
    if not count:
        return np.zeros(shape, dtype)
    return content.view(dtype).reshape(shape, order="F" if fortran else "C")
