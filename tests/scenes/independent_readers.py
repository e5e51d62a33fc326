"""Readers that share nothing with ours, as short as the models of the tests allow; each yields polygons.

A block is ``points [F, n, 3]`` in file axes and ``colors [F, n, 3]`` of the corners, display-referred, with the
nearest texel of their texture. glTF's accessors, OBJ, PLY and STL are read by hand, COLLADA with pycollada.
"""

from __future__ import annotations

import io
import json
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

Blocks = Iterator[tuple[np.ndarray, np.ndarray]]
GREY = 0.7  # of a surface without a colour of its own: ours to choose


@dataclass(frozen=True)
class Summary:
    """What two readers must agree on."""

    low: np.ndarray
    high: np.ndarray
    area: float
    triangles: int
    color: np.ndarray  # [3] mean over the area


def summary(blocks: Blocks) -> Summary:
    lows, highs, area, triangles, color = [], [], 0.0, 0, np.zeros(3)
    for points, colors in blocks:
        rolled = np.roll(points - points[:, :1], -1, axis=1)
        areas = 0.5 * np.linalg.norm(np.cross(points - points[:, :1], rolled).sum(axis=1), axis=1)  # Newell
        kept = areas > 5e-13
        lows.append(points[kept].min(axis=(0, 1)))
        highs.append(points[kept].max(axis=(0, 1)))
        area += areas.sum()
        triangles += int(kept.sum()) * (points.shape[1] - 2)
        color += (areas[:, None] * colors.mean(axis=1)).sum(axis=0)
    return Summary(np.min(lows, axis=0), np.max(highs, axis=0), area, triangles, color / area)


def read(path: Path) -> Blocks:
    return {".glb": gltf, ".gltf": gltf, ".obj": obj, ".ply": ply, ".stl": stl, ".dae": dae}[path.suffix](path)


def display(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def texels(image: Image.Image, uv: np.ndarray) -> np.ndarray:  # v down, repeating
    pixels = np.asarray(image.convert("RGB")) / 255.0
    height, width = pixels.shape[:2]
    return pixels[np.floor(uv[..., 1] % 1.0 * height).astype(int), np.floor(uv[..., 0] % 1.0 * width).astype(int)]


def gltf(path: Path) -> Blocks:
    data = path.read_bytes()
    if path.suffix == ".glb":
        size = struct.unpack_from("<I", data, 12)[0]
        header, buffers = json.loads(data[20 : 20 + size]), [data[28 + size :]]
    else:
        header = json.loads(data)
        buffers = [(path.parent / buffer["uri"]).read_bytes() for buffer in header["buffers"]]

    def view(index):
        entry = header["bufferViews"][index]
        start = entry.get("byteOffset", 0)
        return buffers[entry["buffer"]][start : start + entry["byteLength"]], entry.get("byteStride")

    def values(index):
        entry = header["accessors"][index]
        kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[entry["componentType"]]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[entry["type"]]
        raw, stride = view(entry["bufferView"])
        step = stride or columns * np.dtype(kind).itemsize
        offset = entry.get("byteOffset", 0)
        rows = [np.frombuffer(raw, kind, columns, offset + k * step) for k in range(entry["count"])]
        whole = np.stack(rows)
        return whole / np.iinfo(kind).max if entry.get("normalized") else whole

    def walk(index, parent):
        node = header["nodes"][index]
        matrix = np.array(node.get("matrix", np.eye(4).T.ravel()), float).reshape(4, 4).T
        if "matrix" not in node:
            from scipy.spatial.transform import Rotation

            turn = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
            matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)))
            matrix[:3, 3] = node.get("translation", (0, 0, 0))
        matrix = parent @ matrix
        if "mesh" in node:
            yield node["mesh"], matrix
        for child in node.get("children", ()):
            yield from walk(child, matrix)

    images: dict[int, Image.Image] = {}
    scenes = header.get("scenes", [{"nodes": range(len(header["nodes"]))}])
    for root in scenes[header.get("scene", 0)]["nodes"]:
        for mesh, matrix in walk(root, np.eye(4)):
            for primitive in header["meshes"][mesh]["primitives"]:
                attributes = primitive["attributes"]
                faces = values(primitive["indices"]).reshape(-1, 3)
                points = values(attributes["POSITION"]).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
                pbr = header["materials"][primitive["material"]] if "material" in primitive else None
                pbr = pbr.get("pbrMetallicRoughness", {}) if pbr is not None else None
                colored = pbr is not None or "COLOR_0" in attributes
                plain = [1.0] * 3 if colored else [((GREY + 0.055) / 1.055) ** 2.4] * 3
                light = np.tile(np.array((pbr or {}).get("baseColorFactor", plain))[:3], (len(points), 1))
                if "COLOR_0" in attributes:
                    light = light * values(attributes["COLOR_0"])[:, :3]
                color = display(light)
                if pbr and "baseColorTexture" in pbr and "TEXCOORD_0" in attributes:
                    source = header["textures"][pbr["baseColorTexture"]["index"]]["source"]
                    if source not in images:
                        images[source] = Image.open(io.BytesIO(view(header["images"][source]["bufferView"])[0]))
                    color = color * texels(images[source], values(attributes["TEXCOORD_0"]))
                yield points[faces], color[faces]


def obj(path: Path) -> Blocks:
    lists: dict[str, list] = {"v": [], "vt": [], "vn": []}
    images, colors, material = {}, {}, None
    for line in path.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] in lists:
            lists[words[0]].append([float(word) for word in words[1:]])
        elif words[0] == "mtllib":
            for row in (path.parent / words[1]).read_text().splitlines():
                parts = row.split()
                if parts[:1] == ["newmtl"]:
                    name = parts[1]
                elif parts[:1] == ["Kd"]:
                    colors[name] = [float(value) for value in parts[1:4]]
                elif parts[:1] == ["map_Kd"]:
                    images[name] = Image.open(path.parent / parts[1])
        elif words[0] == "usemtl":
            material = words[1]
        elif words[0] == "f":
            corners = [[int(index) if index else 0 for index in word.split("/")] for word in words[1:]]
            at = [[index - 1 if index > 0 else index for index in corner] for corner in corners]
            points = np.array([lists["v"][corner[0]] for corner in at])
            color = points[:, 3:6] if points.shape[1] >= 6 else np.tile(colors.get(material, [GREY] * 3), (len(at), 1))
            if material in images:
                uv = np.array([lists["vt"][corner[1]] for corner in at])[:, :2] * [1, -1] + [0, 1]
                color = texels(images[material], uv)
            yield points[None, :, :3], color[None]


def ply(path: Path) -> Blocks:
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header\n")
    elements: list[tuple[str, int, list[list[str]]]] = []
    for line in head.decode().splitlines():
        words = line.split()
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property":
            elements[-1][2].append(words[1:])
    stream = iter(body.split())
    place = 0
    formats = {"float": "<f", "uchar": "<B", "int": "<i", "uint": "<I", "double": "<d", "short": "<h"}

    def number(kind):
        nonlocal place
        if b"format ascii" in head:
            return float(next(stream))
        (value,) = struct.unpack_from(formats[kind], body, place)
        place += struct.calcsize(formats[kind])
        return value

    read = {}
    for name, count, properties in elements:
        read[name] = [
            {
                words[-1]: [number(words[2]) for _ in range(int(number(words[1])))] if words[0] == "list"
                else number(words[0])
                for words in properties
            }
            for _ in range(count)
        ]  # fmt: skip
    for face in read["face"]:
        corners = [read["vertex"][int(k)] for k in next(value for value in face.values() if isinstance(value, list))]
        holders = [face] * len(corners) if "red" in face else corners
        colors = [[holder.get(c, 255 * GREY) / 255 for c in ("red", "green", "blue")] for holder in holders]
        yield np.array([[[corner[axis] for axis in "xyz"] for corner in corners]]), np.array([colors])


def stl(path: Path) -> Blocks:
    rows = np.frombuffer(path.read_bytes()[84:], np.dtype([("n", "<f4", 3), ("p", "<f4", (3, 3)), ("a", "<u2")]))
    yield rows["p"].astype(float), np.full((len(rows), 3, 3), GREY)


def dae(path: Path) -> Blocks:
    import collada

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # pycollada 0.9.3 sets the shape of arrays
        document = collada.Collada(str(path))
    for geometry in document.scene.objects("geometry"):
        for primitives in geometry.primitives():
            shapes = primitives.polygons() if hasattr(primitives, "polygons") else primitives.shapes()
            for shape in shapes:
                points = np.asarray(shape.vertices, float)
                effect = getattr(shape.material, "effect", None)
                diffuse = getattr(effect, "diffuse", None)
                color = np.tile([GREY] * 3 if diffuse is None else np.asarray(diffuse)[:3], (len(points), 1))
                yield points[None], color[None]
