"""Reader for glTF 2.0 (`.glb` and `.gltf`).

trimesh reads glTF too, but takes normalised integer coordinates at face value, skips sparse accessors, texture
transforms and second UV sets, and keeps silent about images it cannot find; common exporters write all of these.
Specification: [gltf]; KHR_texture_transform, KHR_mesh_quantization, EXT_texture_webp,
KHR_materials_pbrSpecularGlossiness.
"""

from __future__ import annotations

import base64
import json
import operator
import shlex
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry.rotations import matrix_rows
from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import (
    PLAIN_GREY,
    MeshPart,
    TextureStore,
    placed,
)
from activestructure_gym.scenes.loaders.references import find_reference
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TYPES = {"POSITION": ("VEC3",), "COLOR": ("VEC3", "VEC4"), "TEXCOORD": ("VEC2",)}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_WRAPS = {33071: CLAMP, 33648: MIRROR, 10497: REPEAT}

_PLAIN = [((PLAIN_GREY + 0.055) / 1.055) ** 2.4] * 3  # linear; the specification's white would hide all shading

# Extensions that hold the geometry or the images themselves, what to say about them, and how to do without.
_WITHOUT_COMPRESSION = "export it without compression"
_REFUSED = {
    "EXT_meshopt_compression": ("its geometry is compressed with meshopt", _WITHOUT_COMPRESSION),
    "KHR_meshopt_compression": ("its geometry is compressed with meshopt", _WITHOUT_COMPRESSION),
    "KHR_draco_mesh_compression": ("its geometry is compressed with Draco", _WITHOUT_COMPRESSION),
    "KHR_texture_basisu": ("its textures are KTX2 / Basis", "export them as PNG or JPEG"),
    "EXT_mesh_gpu_instancing": ("it places its objects by GPU instancing", "export them as single nodes"),
}
# Required extensions that are read, or that change nothing for a pinhole camera without lights.
_READ = ("KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp", "MSFT_lod")
_HARMLESS_PREFIXES = ("KHR_materials_", "KHR_lights_", "EXT_lights_", "KHR_animation_", "KHR_xmp", "KHR_node_")


@dataclass(frozen=True)
class GltfFile:
    """The parts in file axes, and what the file says about them."""

    parts: list[MeshPart]
    up: str | None  # the text under "up" in the extras of the asset or of the default scene, None without one


def read_gltf(path: Path, textures: TextureStore) -> GltfFile:
    """All triangles of the default scene. Raises `InputError` for what cannot be read, with the reason."""
    header, binary = _read_container(path, textures.budget.read(path))
    _check_extensions(path, header)
    return GltfFile(list(_Document(path, header, binary, textures).parts()), _declared_up(header))


def _declared_up(header: dict[str, Any]) -> str | None:
    """Our own marker: glTF has one up axis, +y (glTF 2.0, section 3.4), and no field for files that have another."""
    scenes = header.get("scenes") or [{}]
    for holder in (header.get("asset", {}), scenes[header.get("scene", 0)]):
        extras = holder.get("extras")  # of any type, and any program's
        if isinstance(extras, dict) and isinstance(extras.get("up"), str):
            return extras["up"].strip().lower()
    return None


def _read_container(path: Path, data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON header and the binary chunk (empty for `.gltf`)."""
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
    """The header, if it is one of glTF 2.0; the lists of glTF 1.0 were dictionaries."""
    if not isinstance(header, dict):
        raise UnreadableMesh("its JSON is no object with 'asset' and 'meshes', as glTF has it")
    asset = header.get("asset")
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if isinstance(header.get("meshes"), dict) and not version:
        version = "1.0"
    if version and not version.startswith("2"):
        raise UnreadableMesh(_OLD.format(version[:20]))
    return header


def _check_extensions(path: Path, header: dict[str, Any]) -> None:
    required = header.get("extensionsRequired", [])
    if not isinstance(required, list):
        raise UnreadableMesh("its extensionsRequired is no list")
    _refuse(path, [str(name) for name in required if name not in _READ and not _harmless(str(name))])


def _harmless(name: str) -> bool:
    return name.startswith(_HARMLESS_PREFIXES)


def _refuse(path: Path, extensions: list[str]) -> None:
    """Raise `InputError` with reasons and remedies if any of these extensions cannot be read."""
    if not extensions:
        return
    unknown = ("it needs the glTF extension {0}", "export it without {0}")
    faults = [[words.format(name) for words in _REFUSED.get(name, unknown)] for name in extensions]
    reasons, remedies = (list(dict.fromkeys(words)) for words in zip(*faults))
    otherwise = "convert it with gltf-transform or Blender"
    if remedies == [_WITHOUT_COMPRESSION]:
        unpacked = path.with_name(f"{path.stem}_uncompressed{path.suffix}")
        otherwise = f"run: npx @gltf-transform/cli copy {shlex.quote(str(path))} {shlex.quote(str(unpacked))}"
    raise InputError(
        f"'{path}' cannot be read: {' and '.join(reasons)} ({', '.join(extensions)}); {' and '.join(remedies)}, or "
        f"{otherwise}"
    )


class _Document:
    """One glTF file with its buffers; accessors and materials are decoded once, on first use."""

    def __init__(self, path: Path, header: dict[str, Any], binary: bytes, textures: TextureStore) -> None:
        self.path = path
        self.header = header
        self.textures = textures
        self.budget = textures.budget
        self._binary = binary
        self._buffers: dict[str | None, bytes] = {}  # by uri; None is the binary chunk
        self._accessors: dict[int, np.ndarray] = {}
        self._images: dict[int, int] = {}

    def _entry(self, kind: str, index: Any) -> dict[str, Any]:
        """An entry of one of the header's lists."""
        entries = self.header.get(kind, [])
        count = len(entries) if isinstance(entries, list) else 0
        if not isinstance(index, int) or not 0 <= index < count:
            wrong = f"it refers to number {str(index)[:40]} of its {kind}, and there are {count}"
            raise UnreadableMesh(f"{wrong}; export it again")
        if not isinstance(entries[index], dict):
            raise UnreadableMesh(f"number {index} of its {kind} is no object; export it again")
        return entries[index]

    def parts(self) -> Iterator[MeshPart]:
        for mesh_index, world_from_node in self._placed_meshes():
            for primitive in self._entry("meshes", mesh_index)["primitives"]:
                part = self._part(primitive, world_from_node)
                if part is not None:
                    yield part

    def _placed_meshes(self) -> Iterator[tuple[int, np.ndarray]]:
        nodes = self.header.get("nodes", [])
        scenes = self.header.get("scenes")
        if scenes:
            roots = self._entry("scenes", self.header.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in (*node.get("children", []), *_lower_levels(node))}
            roots = [index for index in range(len(nodes)) if index not in children]
        if not nodes:  # a mesh library without a scene
            yield from ((index, np.eye(4)) for index in range(len(self.header.get("meshes", []))))
        stack = [(root, np.eye(4)) for root in reversed(roots)]
        visited = set()
        while stack:
            index, world_from_parent = stack.pop()
            if index in visited:  # every node has one parent
                raise UnreadableMesh("its nodes form a loop or share children")
            visited.add(index)
            self.budget.take("nodes", 1)
            node = self._entry("nodes", index)
            world_from_node = world_from_parent @ _node_matrix(node)
            if "mesh" in node:
                yield node["mesh"], world_from_node
            stack.extend((child, world_from_node) for child in reversed(node.get("children", [])))

    def _part(self, primitive: dict[str, Any], world_from_node: np.ndarray) -> MeshPart | None:
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):  # points and lines
            return None
        attributes = primitive["attributes"]
        self._check_attributes(primitive, attributes)
        positions = self.accessor(attributes["POSITION"])
        self.budget.take("meshes and copies of them", 1)
        indices = self.accessor(primitive["indices"]).reshape(-1) if "indices" in primitive else None
        count = len(positions) if indices is None else len(indices)
        self.budget.take("triangles", count // 3 if mode == _TRIANGLES else max(0, count - 2))
        self.budget.take("vertices", min(count, len(positions)))
        # Exporters let thousands of primitives share one array of vertices: each keeps what it uses.
        used: slice | np.ndarray = slice(None)
        if indices is None:
            indices = np.arange(len(positions))
        elif 0 < len(indices) < len(positions) and indices.max() < len(positions):
            used, indices = np.unique(indices, return_inverse=True)
        material = self._material(primitive.get("material"))
        if "COLOR_0" in attributes:
            colors = self.accessor(attributes["COLOR_0"])[used]
            if colors.dtype.kind in "iu":  # some exporters forget to say that they are normalised
                colors = colors / np.iinfo(colors.dtype).max
            linear = colors[:, :3] * np.asarray(material.get("factor", [1.0] * 4)[:3])
        else:
            linear = np.asarray(material.get("factor", _PLAIN)[:3], dtype=np.float64)
        texture, uv, wrap = self._texture(material.get("texture"), attributes, used)
        return MeshPart(
            vertices=placed(positions[used].astype(np.float64), world_from_node),
            faces=_triangles(indices.astype(np.int64), mode),
            colors=np.clip(linear, 0.0, 1.0),
            uv=uv,
            texture=texture,
            wrap=wrap,
            linear=True,
        )

    def _check_attributes(self, primitive: dict[str, Any], attributes: dict[str, int]) -> None:
        accessors = {name: self._entry("accessors", index) for name, index in attributes.items()}
        # Draco's geometry stands outside of the accessors; where it is not required, there may be a copy in them.
        compressed = [name for name in primitive.get("extensions", {}) if name in _REFUSED]
        if compressed and "bufferView" not in accessors["POSITION"]:
            _refuse(self.path, compressed)
        counts = {name: accessor["count"] for name, accessor in accessors.items()}
        if len(set(counts.values())) > 1:
            said = ", ".join(f"{name} {str(count)[:20]}" for name, count in list(counts.items())[:6])
            raise UnreadableMesh(f"the arrays of one of its meshes have different lengths ({said}); export it again")
        for name, accessor in accessors.items():
            wanted = _TYPES.get(name.partition("_")[0] if name.startswith(("COLOR_", "TEXCOORD_")) else name)
            if wanted and accessor["type"] not in wanted:
                raise UnreadableMesh(f"its {name} is {str(accessor['type'])[:20]} instead of {' or '.join(wanted)}")

    def _material(self, index: int | None) -> dict[str, Any]:
        """Base colour factor (linear) and texture reference of a material; empty where there is no material."""
        if index is None:
            return {}
        material = self._entry("materials", index)
        gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        if gloss is not None:
            factor, texture = gloss.get("diffuseFactor", [1.0] * 4), gloss.get("diffuseTexture")
        else:
            metallic = material.get("pbrMetallicRoughness", {})
            factor, texture = metallic.get("baseColorFactor", [1.0] * 4), metallic.get("baseColorTexture")
        # Baked scenes are often exported as a black surface that shines with its texture.
        if material.get("emissiveTexture") and max(factor[:3]) < 1e-3:
            factor, texture = material.get("emissiveFactor", [1.0] * 3), material["emissiveTexture"]
        return {"factor": factor, "texture": texture}

    def _texture(
        self, info: dict[str, Any] | None, attributes: dict[str, int], used: slice | np.ndarray
    ) -> tuple[int, np.ndarray | None, tuple[int, int]]:
        """Index of the image, its coordinates [V, 2] and how it goes on across and down."""
        nothing = -1, None, (REPEAT, REPEAT)
        if info is None:
            return nothing
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        uv_name = f"TEXCOORD_{transform.get('texCoord', info.get('texCoord', 0))}"
        if uv_name not in attributes:
            self.textures.without_uv.append(f"texture {info['index']}")
            return nothing
        uv = self.accessor(attributes[uv_name])[used].astype(np.float64)
        if transform:
            angle = transform.get("rotation", 0.0)
            # Counter-clockwise seen on the image, whose v axis points down.
            rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            uv = (uv * transform.get("scale", [1.0, 1.0])) @ rotation.T + transform.get("offset", [0.0, 0.0])
        texture = self._entry("textures", info["index"])
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        if source is None:
            self.textures.note_unreadable(f"texture {info['index']}")
            return nothing
        sampler = self._entry("samplers", texture["sampler"]) if "sampler" in texture else {}
        across, down = (_WRAPS.get(sampler.get(key, 0), REPEAT) for key in ("wrapS", "wrapT"))
        return self._image(source), uv, (across, down)

    def _image(self, index: int) -> int:
        if index not in self._images:
            self._images[index] = self._new_image(index)
        return self._images[index]

    def _new_image(self, index: int) -> int:
        image = self._entry("images", index)
        name = image.get("name") or image.get("uri", "")[:60] or f"image {index}"
        if "bufferView" in image:
            view = self._entry("bufferViews", image["bufferView"])
            start = _size(view.get("byteOffset", 0), "byteOffset")
            stop = start + _size(view["byteLength"], "byteLength")
            return self.textures.add_bytes(self._buffer(view["buffer"])[start:stop], name)
        if image["uri"].startswith("data:"):
            return self.textures.add_bytes(_data_uri(image["uri"]), name)
        return self.textures.add_file(self.path.parent, image["uri"])

    def _buffer(self, index: int) -> bytes:
        uri = self._entry("buffers", index).get("uri")
        if uri is None and (index or not self._binary):  # only the first may stand in the file itself
            raise UnreadableMesh(f"its buffer {index} has no data")
        if uri not in self._buffers:
            self._buffers[uri] = self._binary if uri is None else self._bytes_at(uri)
        return self._buffers[uri]

    def _bytes_at(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return _data_uri(uri)
        try:
            return self.budget.read(find_reference(self.path.parent, uri, climb=0))
        except FileNotFoundError as error:
            raise UnreadableMesh(f"its buffer file '{uri[:200]}' is missing") from error
        except LimitError as error:
            raise UnreadableMesh(f"its buffer file '{uri[:200]}' {error}") from error

    def accessor(self, index: int) -> np.ndarray:  # [count, components], float where normalised
        """The values of an accessor, with stride, sparse replacement and normalisation done."""
        if index not in self._accessors:
            accessor = self._entry("accessors", index)
            count, columns = _size(accessor["count"], "count"), _known(_SHAPES, accessor, "type")
            dtype = np.dtype(_known(_COMPONENTS, accessor, "componentType"))
            normalised = accessor.get("normalized") and dtype.kind in "iu"
            if "bufferView" not in accessor or "sparse" in accessor or normalised:
                self.budget.take("numbers in arrays", count * columns)  # these are copied, the others are not
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
        view = self._entry("bufferViews", view_index)
        if compressed := [name for name in view.get("extensions", {}) if name in _REFUSED]:
            buffer = self._entry("buffers", view["buffer"])
            if "uri" not in buffer and view["buffer"]:  # the copy for those who cannot unpack it is left out
                _refuse(self.path, compressed)
        row = columns * dtype.itemsize
        stride = _size(view.get("byteStride", 0), "byteStride") or row  # older exporters write 0 for none
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
    """A value of the header that must be a whole number from 0 on: bytes or rows."""
    if isinstance(value, bool) or not hasattr(value, "__index__") or value < 0:
        raise UnreadableMesh(f"a {name} in it is {str(value)[:40]} and no whole number from 0 on")
    return operator.index(value)


def _known(table: dict[Any, Any], holder: dict[str, Any], key: str) -> Any:
    if not isinstance(value := holder[key], str | int) or value not in table:
        raise UnreadableMesh(f"a {key} in it is {str(value)[:40]}, and glTF knows {', '.join(map(str, table))}")
    return table[value]


def _data_uri(uri: str) -> bytes:
    return base64.b64decode(uri.partition(",")[2])


def _lower_levels(node: dict[str, Any]) -> list[int]:
    """The nodes that stand for this one at a distance (MSFT_lod)."""
    return node.get("extensions", {}).get("MSFT_lod", {}).get("ids", [])


def _node_matrix(node: dict[str, Any]) -> np.ndarray:  # [4, 4] parent_from_node
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix[:3, :3] = matrix_rows(w, x, y, z)
    matrix[:3, :3] *= node.get("scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _triangles(indices: np.ndarray, mode: int) -> np.ndarray:  # [F, 3]; winding does not matter here
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    if mode == _STRIP:
        return np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    return np.stack([np.broadcast_to(indices[:1], len(indices[1:-1])), indices[1:-1], indices[2:]], axis=1)
