"""Read the content of a glTF 2.0 file: header, buffers and accessors. Specification: [gltf]."""

from __future__ import annotations

import base64
import json
import operator
import struct
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.scenes.loaders.budget import LimitError, SceneBudget
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.gltf_extensions import REFUSED, refuse
from activestructure_gym.scenes.loaders.references import find_reference

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def _read_container(path: Path, data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON header and the binary chunk (empty for `.gltf`) of a file with the content ``data``."""
    if data[:4] != b"glTF":
        if path.suffix.lower() == ".glb":
            raise UnreadableMesh("it does not begin with the letters 'glTF'")
        return _checked(json.loads(data.decode("utf-8-sig"))), b""
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise UnreadableMesh(_OLD.format(version))
    if length > len(data):
        raise UnreadableMesh(f"it is cut off after {len(data)} of {length} bytes")
    header, binary, position = None, b"", 12
    while position + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, position)
        chunk = data[position + 8 : position + 8 + size]
        if kind == b"JSON":
            header = json.loads(chunk.decode("utf-8"))
        elif kind == b"BIN\0" and not binary:
            binary = chunk
        position += 8 + size
    if header is None:
        raise UnreadableMesh("it has no JSON chunk")
    return _checked(header), binary


_OLD = "it is glTF {}, and only glTF 2.0 is read; convert it with gltf-pipeline or Blender"


def _checked(header: Any) -> dict[str, Any]:
    """Return the header if it is glTF 2.0, else raise `UnreadableMesh`; glTF 1.0 has dictionaries instead of lists."""
    if not isinstance(header, dict):
        raise UnreadableMesh("its JSON is not an object with 'asset' and 'meshes', as glTF has it")
    asset = header.get("asset")
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if isinstance(header.get("meshes"), dict) and not version:
        version = "1.0"
    if version and not version.startswith("2"):
        raise UnreadableMesh(_OLD.format(version[:20]))
    return header


class GltfData:
    """Hold one glTF file with its buffers; accessors are decoded once, on first use."""

    def __init__(self, path: Path, budget: SceneBudget) -> None:
        self.path = path
        self.budget = budget
        self.header, self._binary = _read_container(path, budget.read(path))
        self._buffers: dict[str | None, bytes] = {}  # by uri; None is the binary chunk
        self._accessors: dict[int, np.ndarray] = {}

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """Return entry ``index`` of the header's list ``kind``, such as "meshes"; raise `UnreadableMesh` if missing."""
        entries = self.header.get(kind, [])
        count = len(entries) if isinstance(entries, list) else 0
        if not isinstance(index, int) or not 0 <= index < count:
            wrong = f"it refers to number {str(index)[:40]} of its {kind}, and there are {count}"
            raise UnreadableMesh(f"{wrong}; export it again")
        if not isinstance(entries[index], dict):
            raise UnreadableMesh(f"number {index} of its {kind} is not an object; export it again")
        return entries[index]

    def view_bytes(self, index: int) -> bytes:
        """Return the bytes of the buffer view number ``index``."""
        view = self.entry("bufferViews", index)
        start = _size(view.get("byteOffset", 0), "byteOffset")
        return self._buffer(view["buffer"])[start : start + _size(view["byteLength"], "byteLength")]

    def _buffer(self, index: int) -> bytes:
        uri = self.entry("buffers", index).get("uri")
        if uri is None and (index or not self._binary):  # only the first buffer may be embedded
            raise UnreadableMesh(f"its buffer {index} has no data")
        if uri not in self._buffers:
            self._buffers[uri] = self._binary if uri is None else self._bytes_at(uri)
        return self._buffers[uri]

    def _bytes_at(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return data_uri(uri)
        try:
            return self.budget.read(find_reference(self.path.parent, uri, climb=0))
        except FileNotFoundError as error:
            raise UnreadableMesh(f"its buffer file '{uri[:200]}' is missing") from error
        except LimitError as error:
            raise UnreadableMesh(f"its buffer file '{uri[:200]}' {error}") from error

    def accessor(self, index: int) -> np.ndarray:  # [count, components], float where normalised
        """Return the values of an accessor, with stride, sparse values and normalisation applied."""
        if index not in self._accessors:
            accessor = self.entry("accessors", index)
            count, columns = _size(accessor["count"], "count"), _known(_SHAPES, accessor, "type")
            dtype = np.dtype(_known(_COMPONENTS, accessor, "componentType"))
            normalised = accessor.get("normalized") and dtype.kind in "iu"
            if "bufferView" not in accessor or "sparse" in accessor or normalised:
                self.budget.take("numbers in arrays", count * columns)  # these values are copied, others are not
            if "bufferView" in accessor:
                values = self._values(accessor["bufferView"], accessor.get("byteOffset", 0), count, columns, dtype)
            else:
                values = np.zeros((count, columns), dtype)
            if "sparse" in accessor:
                values = self._with_sparse(values, accessor["sparse"], dtype)
            if normalised:
                values = np.maximum(values.astype(np.float64) / np.iinfo(dtype).max, -1.0)
            self._accessors[index] = values
        return self._accessors[index]

    def _values(self, view_index: int, offset: int, count: int, columns: int, dtype: np.dtype) -> np.ndarray:
        view = self.entry("bufferViews", view_index)
        if compressed := [name for name in view.get("extensions", {}) if name in REFUSED]:
            buffer = self.entry("buffers", view["buffer"])
            if "uri" not in buffer and view["buffer"]:  # the uncompressed copy is missing
                refuse(self.path, compressed)
        row = columns * dtype.itemsize
        stride = _size(view.get("byteStride", 0), "byteStride") or row  # older exporters write 0 for no stride
        if stride < row:
            raise UnreadableMesh(f"its rows of {row} bytes lie {stride} bytes apart (byteStride)")
        content = self._buffer(view["buffer"])
        start = _size(view.get("byteOffset", 0), "byteOffset") + _size(offset, "byteOffset")
        if count and start + (count - 1) * stride + row > len(content):
            raise UnreadableMesh("its binary data are cut off")
        if not count:
            return np.zeros((0, columns), dtype)
        return np.ndarray((count, columns), dtype, content, start, (stride, dtype.itemsize))

    def _with_sparse(self, values: np.ndarray, sparse: dict[str, Any], dtype: np.dtype) -> np.ndarray:
        count = _size(sparse["count"], "count")
        at, to = sparse["indices"], sparse["values"]
        index_dtype = np.dtype(_known(_COMPONENTS, at, "componentType"))
        rows = self._values(at["bufferView"], at.get("byteOffset", 0), count, 1, index_dtype)[:, 0]
        values = values.copy()
        values[rows] = self._values(to["bufferView"], to.get("byteOffset", 0), count, values.shape[1], dtype)
        return values


def _size(value: Any, name: str) -> int:
    """Return the header value ``name``, a non-negative integer; raise `UnreadableMesh` for another value."""
    if isinstance(value, bool) or not hasattr(value, "__index__") or value < 0:
        raise UnreadableMesh(f"a {name} in it is {str(value)[:40]} and no whole number from 0 on")
    return operator.index(value)


def _known(table: dict[Any, Any], holder: dict[str, Any], key: str) -> Any:
    if not isinstance(value := holder[key], str | int) or value not in table:
        raise UnreadableMesh(f"a {key} in it is {str(value)[:40]}, and glTF knows {', '.join(map(str, table))}")
    return table[value]


def data_uri(uri: str) -> bytes:
    """Return the bytes that are encoded in a ``data:`` URI (base 64)."""
    return base64.b64decode(uri.partition(",")[2])
