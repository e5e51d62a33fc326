"""Reader for STL, text and binary: nothing but triangles, each with corners of its own."""

from __future__ import annotations

import re

import numpy as np

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import PLAIN_GREY, MeshPart

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84  # bytes: 80 of anything, then the count
_NAME = re.compile(rb"^\s*(?:end)?solid\b.*$", re.MULTILINE | re.IGNORECASE)  # may hold the word vertex
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(data: bytes) -> list[MeshPart]:
    """All triangles of all solids as one grey part."""
    count = int.from_bytes(data[80:_HEADER], "little")
    if len(data) == _HEADER + count * _RECORD.itemsize:
        corners = np.frombuffer(data, _RECORD, count, _HEADER)["corners"].astype(np.float64).reshape(-1, 3)
    elif b"\0" in data:
        raise UnreadableMesh(
            f"it is neither text nor a whole binary STL ({len(data)} bytes where its header says "
            f"{_HEADER + count * _RECORD.itemsize})"
        )
    else:
        corners = np.array(_VERTEX.findall(_NAME.sub(b"", data))).astype(np.float64).reshape(-1, 3)
    if len(corners) % 3:
        raise UnreadableMesh(f"its triangles have {len(corners)} corners in all, which is no multiple of 3")
    return [MeshPart(corners, np.arange(len(corners)).reshape(-1, 3), np.full(3, PLAIN_GREY))]
