"""Read and write arrays in npz files. A file to read may be damaged or made to attack the reader.

An npz file is a zip archive of npy files. Both formats state the size of the data before the data, and the stated size
may be false. No Python object is unpickled. Arrays whose stated size is implausible for the bytes on disk are refused
before memory is allocated.
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

MAX_BYTES = 1 << 30  # default limit on the bytes of all arrays of a file together: 1 GiB
# A file may unpack to at most _RATIO times its bytes plus _SMALL bytes. Deflate compresses zeros by a factor of 1000,
# but real arrays (images, masks) by a factor of about 10.
_RATIO, _SMALL = 200, 64 << 20
_MAX_ARRAYS = 1000  # largest number of arrays in a file


def read_npz(path: str | os.PathLike[str], largest: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Return all arrays of an npz file by name.

    Raises OSError if the file cannot be opened, and ValueError for any other fault, such as more than ``largest`` bytes
    in all arrays together.
    """
    if Path(path).exists() and not Path(path).is_file():  # reading from a pipe or a device might not end
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
    """Write named arrays to an npz file, compressed unless `read_npz` would refuse the compression ratio."""
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
    """Return the array stored in npy format in the next ``size`` bytes of a stream; ``name`` is for messages.

    Raises ValueError for false sizes, and any error of numpy's parser.
    """
    start = stream.tell()
    version = npy.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = npy.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = npy.read_array_header_2_0(stream)
    else:
        raise ValueError(f"'{name}' has the npy version {version}, expected 1.0 or 2.0")
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
