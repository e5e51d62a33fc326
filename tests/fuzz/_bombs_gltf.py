"""glTF files that ask for much: huge counts, doubled nodes, many accessors."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from tests.fuzz._bomb_sizes import DEVICES, HUGE, fan_out, pick, put_devices
from tests.fuzz._rooms import FACES, glb_of, gltf_room, rooms


def make_counts(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    accessor = gltf.header["accessors"][rng.integers(5)]
    accessor["count"] = pick(rng, HUGE)
    if rng.random() < 0.5:
        accessor.pop("bufferView")
    if rng.random() < 0.3:
        accessor["byteOffset"] = pick(rng, (*HUGE, -4, -(2**63)))
    return gltf.write(folder / "a.glb")


def make_strides(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    for view in gltf.header["bufferViews"]:
        view["byteStride"] = pick(rng, (0, 1, 2, 252, 2**31, -12, 2**63))
        if rng.random() < 0.5:
            view["byteLength"] = pick(rng, HUGE)
    gltf.header["accessors"][rng.integers(5)]["count"] = pick(rng, HUGE)
    return gltf.write(folder / "a.glb")


def make_sparse(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    accessor = gltf.header["accessors"][-1]
    accessor.pop("bufferView")
    accessor["count"] = pick(rng, (3_000_000, 9_000_000, *HUGE))
    if rng.random() < 0.5:
        accessor["sparse"]["count"] = pick(rng, HUGE)
    return gltf.write(folder / "a.glb")


def make_many_accessors(rng: np.random.Generator, folder: Path) -> Path:
    """Each is a copy of the same bytes as float64."""
    gltf = gltf_room()
    view = gltf.view(bytes(1 << 20))
    primitive = gltf.header["meshes"][0]["primitives"][0]
    first = len(gltf.header["accessors"])
    count = 3000
    for _ in range(count):
        gltf.header["accessors"].append(
            {"bufferView": view, "componentType": 5121, "count": 1 << 18, "type": "VEC4", "normalized": True}
        )
    gltf.header["meshes"][0]["primitives"] = [
        {**primitive, "attributes": {**primitive["attributes"], "COLOR_0": first + k}} for k in range(count)
    ]
    return gltf.write(folder / "a.glb")


def make_node_trees(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    levels, copies = fan_out(rng)
    loop = levels if rng.random() < 0.3 else 0
    gltf.header["nodes"] = [{"mesh": 0, "children": [(k + 1) % (levels + loop)] * copies} for k in range(levels)]
    gltf.header["nodes"].append({"mesh": 0})
    return gltf.write(folder / "a.glb")


def make_deep_nodes(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    count = int(rng.integers(1000, 60_000))
    gltf.header["nodes"] = [{"children": [k + 1]} for k in range(count)] + [{"mesh": 0}]
    return gltf.write(folder / "a.glb")


def make_instances(rng: np.random.Generator, folder: Path) -> Path:
    """A mesh of many triangles, placed many times."""
    gltf = gltf_room()
    triangles = int(pick(rng, (10, 1000, 30_000)))
    primitive = gltf.header["meshes"][0]["primitives"][0]
    primitive["indices"] = gltf.accessor(np.tile(FACES.astype(np.uint16).reshape(-1), triangles // 10))
    gltf.header["nodes"] = [{"mesh": 0}] * int(pick(rng, (100, 1000, 40_000)))
    gltf.header["scenes"] = [{"nodes": list(range(len(gltf.header["nodes"])))}]
    return gltf.write(folder / "a.glb")


def make_cities(rng: np.random.Generator, folder: Path) -> Path:
    """As many copies side by side as a scene may have, and more."""
    gltf = gltf_room()
    side = int(pick(rng, (6, 12, 40)))  # cells of a floor, which has two triangles each
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 4, side + 1), np.linspace(0, 3, side + 1)))
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1)
    faces = np.hstack([first + [0, 1, side + 1], first + [1, side + 2, side + 1]])
    floor = np.stack([x, y, np.zeros(len(x))], axis=1).astype(np.float32)
    primitive = {"attributes": {"POSITION": gltf.accessor(floor)}}
    gltf.header["meshes"].append(
        {"primitives": [primitive | {"indices": gltf.accessor(faces.astype(np.uint16).ravel())}]}
    )
    count = int(pick(rng, (2_900_000, 3_100_000))) // (2 * side**2)
    places = np.stack(np.unravel_index(np.arange(count), (45, 55, count // 2475 + 1)), axis=1) * [4.1, 3.1, 3.0]
    gltf.header["nodes"] = [{"mesh": 0}] + [{"mesh": 2, "translation": place} for place in places.tolist()]
    gltf.header["scenes"] = [{"nodes": list(range(count + 1))}]
    return gltf.write(folder / "a.glb")


def make_primitives(rng: np.random.Generator, folder: Path) -> Path:
    """Thousands of primitives over one long array of vertices."""
    gltf = gltf_room()
    primitive = gltf.header["meshes"][0]["primitives"][0]
    primitive["attributes"] = {
        "POSITION": gltf.accessor(np.tile(gltf_corners(), (30_000, 1))),
    }
    if rng.random() < 0.5:
        primitive.pop("indices")
    gltf.header["meshes"][0]["primitives"] = [primitive] * int(pick(rng, (200, 5000, 30_000)))
    return gltf.write(folder / "a.glb")


def gltf_corners() -> np.ndarray:
    from tests.fuzz._rooms import CORNERS

    return CORNERS.astype(np.float32)


def make_strips(rng: np.random.Generator, folder: Path) -> Path:
    """Triangles of one byte each."""
    gltf = gltf_room()
    primitive = gltf.header["meshes"][0]["primitives"][0]
    primitive["mode"] = int(rng.integers(5, 7))
    primitive["indices"] = gltf.accessor(rng.integers(0, 8, int(pick(rng, (10**6, 2 * 10**7)))).astype(np.uint8))
    return gltf.write(folder / "a.glb")


def make_json(rng: np.random.Generator, folder: Path) -> Path:
    deep = int(pick(rng, (900, 5000, 200_000)))
    text = pick(
        rng,
        (
            b"[" * deep + b"]" * deep,
            b'{"a":' * deep + b"1" + b"}" * deep,
            b'{"meshes": ' + b"[" * deep + b"]" * deep + b"}",
            b'{"nodes": [' + b"{}," * 200_000 + b"{}]}",
            b'{"nodes": [' + b"9" * 100_000 + b"]}",
            b'{"asset": {"version": "2.0"}, "extensionsRequired": ["' + b"x" * 100_000 + b'"]}',
            b'{"nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 1e308}}]}]}',
        ),
    )
    (folder / "a.glb").write_bytes(glb_of(text, b""))
    (folder / "a.gltf").write_bytes(text)
    return folder / pick(rng, ("a.glb", "a.gltf"))


def make_chunks(rng: np.random.Generator, folder: Path) -> Path:
    data = bytearray(rooms()["glb"]["room.glb"])
    kind = rng.integers(3)
    if kind == 0:
        struct.pack_into("<I", data, int(pick(rng, (8, 12))), int(pick(rng, (0, 7, 2**31, 2**32 - 1))))
    elif kind == 1:
        data += struct.pack("<I4s", 0, b"JSON") * 50_000
        struct.pack_into("<I", data, 8, len(data))
    else:
        data = bytearray(data[: rng.integers(30)])
    (folder / "a.glb").write_bytes(data)
    return folder / "a.glb"


def make_buffers(rng: np.random.Generator, folder: Path) -> Path:
    """Buffers that are devices, pipes, folders, other people's files, or no base64."""
    gltf = gltf_room()
    put_devices(folder)
    uri = pick(
        rng,
        (
            *DEVICES, "pipe", "zero", "kernel", ".", "..", "a.gltf", "../" * 20 + "etc/passwd", "x" * 5000, "a\0b", "",
            "file:///etc/passwd", "data:;base64,###", "data:," + "A" * 10_000, "http://localhost/x.bin", "%00", 3, None,
        ),
    )  # fmt: skip
    gltf.header["buffers"] = [{"byteLength": len(gltf.data), "uri": uri}]
    path = gltf.write(folder / "a.gltf")
    return path


def make_buffer_lists(rng: np.random.Generator, folder: Path) -> Path:
    """The same megabyte under many names and through many buffers."""
    gltf = gltf_room()
    (folder / "a.bin").write_bytes(gltf.data.ljust(1 << 20))
    count = 3000
    gltf.header["buffers"] = [
        {"byteLength": 1 << 20, "uri": ("./" * (k % 500)) + ("a.bin" if k % 2 else "%61.bin")} for k in range(count)
    ]
    index = gltf.header["accessors"][1]["bufferView"]
    view = gltf.header["bufferViews"][index]
    gltf.header["bufferViews"] += [{**view, "buffer": k} for k in range(count)]
    primitive = gltf.header["meshes"][0]["primitives"][0]
    accessor = gltf.header["accessors"][1]
    gltf.header["meshes"][0]["primitives"] = []
    for k in range(count):
        gltf.header["accessors"].append({**accessor, "bufferView": len(gltf.header["bufferViews"]) - count + k})
        gltf.header["meshes"][0]["primitives"].append({**primitive, "indices": len(gltf.header["accessors"]) - 1})
    return gltf.write(folder / "a.gltf")
