"""Read STL, text and binary: only triangles, each with its own corners.

Binary files may have a colour per triangle in two unused bytes of the format. There are two conventions: that of
Magics, which writes `COLOR=` into the header, and that of VisCAM and SolidView.
"""

from __future__ import annotations

import re

import numpy as np

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import PLAIN_GREY, MeshPart, TextureStore

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes: 80 of any content, then the number of triangles
_NAME = re.compile(rb"^\s*(?:end)?solid\b.*$", re.MULTILINE | re.IGNORECASE)  # a name may contain the word vertex
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_MAGICS = b"COLOR="  # colour of the whole object in 4 bytes: red, green, blue, alpha
_TOP_BIT = 1 << 15


def read_stl(data: bytes, textures: TextureStore) -> list[MeshPart]:
    """Return all triangles of an STL file with the content ``data`` as one part; grey if the file has no colours."""
    count = int.from_bytes(data[80:_HEADER], "little")
    end = _HEADER + count * _RECORD.itemsize
    colors: np.ndarray = np.full(3, PLAIN_GREY)
    if len(data) == end or count and len(data) > end:
        records = np.frombuffer(data, _RECORD, count, _HEADER)
        corners = records["corners"].astype(np.float64).reshape(-1, 3)
        colors = _colors(data[:80], records["attribute"], textures)
        if len(data) > end:
            textures.notes.append(f"{len(data) - end} bytes behind its {count} triangles were not read")
    elif b"\0" in data:
        raise UnreadableMesh(
            f"it is neither text nor a whole binary STL ({len(data)} bytes where its header says {end})"
        )
    else:
        corners = np.array(_VERTEX.findall(_NAME.sub(b"", data))).astype(np.float64).reshape(-1, 3)
    if len(corners) % 3:
        raise UnreadableMesh(f"its triangles have {len(corners)} corners in all, which is not a multiple of 3")
    return [MeshPart(corners, np.arange(len(corners)).reshape(-1, 3), colors)]


def _colors(header: bytes, attributes: np.ndarray, textures: TextureStore) -> np.ndarray:
    """Return the colour of the object [3], or of every corner [3 F, 3] if triangles have colours of their own.

    ``attributes`` [F] are the two colour bytes of each triangle.
    """
    place = header.find(_MAGICS)
    marked = (attributes & _TOP_BIT) != 0
    shares = np.stack([attributes >> shift & 31 for shift in (0, 5, 10)], axis=1) / 31.0
    whole: np.ndarray = np.full(3, PLAIN_GREY)
    if place >= 0 and place + len(_MAGICS) + 4 <= len(header):
        whole = np.frombuffer(header, np.uint8, 3, place + len(_MAGICS)) / 255.0
        own = ~marked if attributes.any() else marked  # Magics: red in the lowest bits; top bit: colour of the object
    else:
        shares, own = shares[:, ::-1], marked  # VisCAM: blue in the lowest bits; top bit: colour of the triangle
        if attributes.any() and not marked[attributes > 0].all():
            textures.notes.append("the colours of its triangles follow no known convention and were not read")
            return whole
    if not own.any():
        return whole
    return np.repeat(np.where(own[:, None], shares, whole), 3, axis=0)
