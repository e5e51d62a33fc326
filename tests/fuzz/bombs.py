"""Small files that ask for much: huge counts, doubled nodes, pictures of one colour, devices for files."""

from __future__ import annotations

import base64
import io
import os
import struct
import zlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.fuzz._rooms import (
    FACES,
    MTL,
    QUADS,
    Gltf,
    dae_text,
    encoded,
    glb_of,
    gltf_room,
    load,
    obj_text,
    ply_text,
    rooms,
    stl_binary,
    stl_text,
)

CI_CASES = 15
_HUGE = (10**6, 10**8, 2**31 - 1, 2**32, 2**40, 2**63 - 1, 2**63, 10**30)
_DEVICES = ("/dev/zero", "/dev/stdin", "/proc/kmsg", "/proc/self/mem", "/dev/tty", "/etc/passwd", "/proc/self/environ")


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    bombs = [make for name, make in sorted(globals().items()) if name.startswith("make_")]
    path = bombs[rng.integers(len(bombs))](rng, folder)
    options = {"up": "z"} if str(path).endswith((".glb", ".gltf")) else {}
    return lambda: load(path, **options)


def _pick(rng: np.random.Generator, choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _fan_out(rng: np.random.Generator) -> tuple[int, int]:
    """Levels and copies per level whose product of copies is astronomical."""
    return _pick(rng, ((40, 2), (20, 4), (190, 2), (3, 3000), (2, 40_000)))


# glTF


def make_counts(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    accessor = gltf.header["accessors"][rng.integers(5)]
    accessor["count"] = _pick(rng, _HUGE)
    if rng.random() < 0.5:
        accessor.pop("bufferView")
    if rng.random() < 0.3:
        accessor["byteOffset"] = _pick(rng, (*_HUGE, -4, -(2**63)))
    return gltf.write(folder / "a.glb")


def make_strides(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    for view in gltf.header["bufferViews"]:
        view["byteStride"] = _pick(rng, (0, 1, 2, 252, 2**31, -12, 2**63))
        if rng.random() < 0.5:
            view["byteLength"] = _pick(rng, _HUGE)
    gltf.header["accessors"][rng.integers(5)]["count"] = _pick(rng, _HUGE)
    return gltf.write(folder / "a.glb")


def make_sparse(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    accessor = gltf.header["accessors"][-1]
    accessor.pop("bufferView")
    accessor["count"] = _pick(rng, (3_000_000, 9_000_000, *_HUGE))
    if rng.random() < 0.5:
        accessor["sparse"]["count"] = _pick(rng, _HUGE)
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
    levels, copies = _fan_out(rng)
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
    triangles = int(_pick(rng, (10, 1000, 30_000)))
    primitive = gltf.header["meshes"][0]["primitives"][0]
    primitive["indices"] = gltf.accessor(np.tile(FACES.astype(np.uint16).reshape(-1), triangles // 10))
    gltf.header["nodes"] = [{"mesh": 0}] * int(_pick(rng, (100, 1000, 40_000)))
    gltf.header["scenes"] = [{"nodes": list(range(len(gltf.header["nodes"])))}]
    return gltf.write(folder / "a.glb")


def make_cities(rng: np.random.Generator, folder: Path) -> Path:
    """As many copies side by side as a scene may have, and more."""
    gltf = gltf_room()
    side = int(_pick(rng, (6, 12, 40)))  # cells of a floor, which has two triangles each
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 4, side + 1), np.linspace(0, 3, side + 1)))
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1)
    faces = np.hstack([first + [0, 1, side + 1], first + [1, side + 2, side + 1]])
    floor = np.stack([x, y, np.zeros(len(x))], axis=1).astype(np.float32)
    primitive = {"attributes": {"POSITION": gltf.accessor(floor)}}
    gltf.header["meshes"].append(
        {"primitives": [primitive | {"indices": gltf.accessor(faces.astype(np.uint16).ravel())}]}
    )
    count = int(_pick(rng, (2_900_000, 3_100_000))) // (2 * side**2)
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
    gltf.header["meshes"][0]["primitives"] = [primitive] * int(_pick(rng, (200, 5000, 30_000)))
    return gltf.write(folder / "a.glb")


def gltf_corners() -> np.ndarray:
    from tests.fuzz._rooms import CORNERS

    return CORNERS.astype(np.float32)


def make_strips(rng: np.random.Generator, folder: Path) -> Path:
    """Triangles of one byte each."""
    gltf = gltf_room()
    primitive = gltf.header["meshes"][0]["primitives"][0]
    primitive["mode"] = int(rng.integers(5, 7))
    primitive["indices"] = gltf.accessor(rng.integers(0, 8, int(_pick(rng, (10**6, 2 * 10**7)))).astype(np.uint8))
    return gltf.write(folder / "a.glb")


def make_json(rng: np.random.Generator, folder: Path) -> Path:
    deep = int(_pick(rng, (900, 5000, 200_000)))
    text = _pick(
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
    return folder / _pick(rng, ("a.glb", "a.gltf"))


def make_chunks(rng: np.random.Generator, folder: Path) -> Path:
    data = bytearray(rooms()["glb"]["room.glb"])
    kind = rng.integers(3)
    if kind == 0:
        struct.pack_into("<I", data, int(_pick(rng, (8, 12))), int(_pick(rng, (0, 7, 2**31, 2**32 - 1))))
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
    _devices(folder)
    uri = _pick(
        rng,
        (
            *_DEVICES, "pipe", "zero", "kernel", ".", "..", "a.gltf", "../" * 20 + "etc/passwd", "x" * 5000, "a\0b", "",
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


# Pictures


@lru_cache(maxsize=4)
def plain_png(width: int, height: int, shade: int = 90) -> bytes:
    """A picture of one colour: about a thousandth of its size, written row by row."""
    pack = zlib.compressobj(1)
    row = b"\0" + bytes([shade]) * (3 * width)
    packed = b"".join(pack.compress(row) for _ in range(height)) + pack.flush()
    return png_of((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", packed), (b"IEND", b""))


def png_of(*chunks: tuple[bytes, bytes]) -> bytes:
    framed = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(framed)


def forged(data: bytes, kind: str, side: int) -> bytes:
    """A picture whose header says another size."""
    place, form = {
        "PNG": (16, ">II"), "GIF": (6, "<HH"), "BMP": (18, "<ii"), "TGA": (12, "<HH"),
        "JPEG": (data.find(b"\xff\xc0") + 5, ">HH"),
    }[kind]  # fmt: skip
    forged = bytearray(data)
    struct.pack_into(form, forged, place, *[min(side, 2**31 - 1 if form[-1] in "iI" else 65535)] * 2)
    if kind == "PNG":
        struct.pack_into(">I", forged, 29, zlib.crc32(bytes(forged[12:29])))
    return bytes(forged)


def _picture(rng: np.random.Generator) -> bytes:
    """One that asks for much."""
    side = int(_pick(rng, (8193, 13_000, 30_000, 65_535, 2**31 - 1)))
    kind = rng.integers(9)
    if kind < 3:
        name = str(_pick(rng, ("PNG", "GIF", "BMP", "TGA", "JPEG")))
        return forged(encoded(name), name, side)
    if kind == 3:
        return plain_png(int(_pick(rng, (4096, 8192, 9000))), int(_pick(rng, (8192, 9000))))
    if kind == 4:
        bomb = zlib.compress(bytes(50 << 20))
        text = _pick(rng, ((b"zTXt", b"a\0\0"), (b"iCCP", b"a\0\0"), (b"iTXt", b"a\0\1\0\0\0")))
        chunk = (text[0], text[1] + bomb)
        return png_of((b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0)), *[chunk] * 20, (b"IEND", b""))
    if kind == 5:
        return encoded(_pick(rng, ("EPS", "PDF", "ICO", "PPM", "SGI", "PCX", "DDS", "XBM", "IM", "MPO", "AVIF")))
    if kind == 6:
        jpeg = encoded("JPEG", (64, 64), progressive=True)
        scan = jpeg[jpeg.index(b"\xff\xda") : jpeg.rindex(b"\xff\xd9")]
        return _forged_progressive(jpeg[:-2] + scan * int(_pick(rng, (5, 2000))) + jpeg[-2:], side)
    if kind == 7:
        stream = io.BytesIO()
        Image.new("1", (int(_pick(rng, (4096, 16_000))), 4096)).save(stream, "TIFF", compression="group4")
        return stream.getvalue()
    return _webp(side)


def _forged_progressive(data: bytes, side: int) -> bytes:
    forged = bytearray(data)
    struct.pack_into(">HH", forged, data.find(b"\xff\xc2") + 5, min(side, 8000), min(side, 8000))
    return bytes(forged)


@lru_cache(maxsize=1)
def _webp_bytes() -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (16_000, 9000)).save(stream, "WEBP", lossless=True, method=0, quality=0)
    return stream.getvalue()


def _webp(side: int) -> bytes:
    if side > 10_000:
        return _webp_bytes()
    return encoded("WEBP")[:-3]


def make_pictures(rng: np.random.Generator, folder: Path) -> Path:
    return gltf_room(_picture(rng)).write(folder / "a.glb")


def make_pictures_of_obj(rng: np.random.Generator, folder: Path) -> Path:
    (folder / "room.obj").write_text(obj_text())
    (folder / "room.mtl").write_text(MTL)
    (folder / "paper.png").write_bytes(_picture(rng))
    return folder / "room.obj"


def make_pictures_of_dae(rng: np.random.Generator, folder: Path) -> Path:
    (folder / "a.dae").write_text(dae_text())
    (folder / "paper.png").write_bytes(_picture(rng))
    return folder / "a.dae"


def make_albums(rng: np.random.Generator, folder: Path) -> Path:
    """Many pictures of one colour: each is small, all together are not."""
    gltf = gltf_room()
    side, count = _pick(rng, ((13_000, 60), (8192, 60), (4096, 60), (512, 4000)))
    first = plain_png(side, side)
    primitive = gltf.header["meshes"][1]["primitives"][0]
    gltf.header["meshes"][1]["primitives"] = []
    for k in range(count):  # the same picture with another remark is another picture
        data = first[:-12] + png_of((b"tEXt", b"a\0%d" % k))[8:] + first[-12:]
        gltf.header["images"].append({"bufferView": gltf.view(data)})
        gltf.header["textures"].append({"source": k + 1})
        gltf.header["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": {"index": k + 1}}})
        gltf.header["meshes"][1]["primitives"].append({**primitive, "material": k + 2})
    return gltf.write(folder / "a.glb")


def make_picture_references(rng: np.random.Generator, folder: Path) -> Path:
    _devices(folder)
    name = _pick(
        rng, (*_DEVICES, "pipe", "zero", "kernel", ".", "x" * 5000, "a\0b", "../../../../etc/passwd", "~/x.png")
    )
    kind = rng.integers(4)
    if kind == 0:
        return gltf_room(uri=str(name)).write(folder / "a.glb")
    if kind == 1:
        (folder / "room.obj").write_text(obj_text())
        (folder / "room.mtl").write_text(MTL.replace("paper.png", str(name)))
        return folder / "room.obj"
    if kind == 2:
        (folder / "room.obj").write_text(obj_text().replace("room.mtl", str(name)))
        return folder / "room.obj"
    (folder / "a.ply").write_bytes(ply_text().replace(b"made by hand", b"TextureFile " + str(name).encode()))
    return folder / "a.ply"


def _devices(folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    (folder / "zero").symlink_to("/dev/zero")
    (folder / "kernel").symlink_to("/proc/kmsg")


def make_image_views(rng: np.random.Generator, folder: Path) -> Path:
    """Pictures that overlap in one long buffer."""
    gltf = gltf_room()
    start = gltf.header["bufferViews"][gltf.view(encoded("PNG") + bytes(8 << 20))]["byteOffset"]
    primitive = gltf.header["meshes"][1]["primitives"][0]
    gltf.header["meshes"][1]["primitives"] = []
    for k in range(500):
        view = {"buffer": 0, "byteOffset": start, "byteLength": (8 << 20) - k}
        gltf.header["bufferViews"].append(view)
        gltf.header["images"].append({"bufferView": len(gltf.header["bufferViews"]) - 1})
        gltf.header["textures"].append({"source": k + 1})
        gltf.header["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": {"index": k + 1}}})
        gltf.header["meshes"][1]["primitives"].append({**primitive, "material": k + 2})
    return gltf.write(folder / "a.glb")


# OBJ


def make_obj_lines(rng: np.random.Generator, folder: Path) -> Path:
    count = int(_pick(rng, (1000, 20_000, 100_000)))
    kind = rng.integers(13)
    faces = {
        0: "".join(f"usemtl m{k}\nf 1 2 3\n" for k in range(count)),
        1: "".join(f"g g{k}\nf 1 2 3\n" for k in range(count)),
        2: "".join(f"o o{k}\nusemtl red\nf 1 2 3\n" for k in range(count)),
        3: "f " + " ".join(str(1 + k % 8) for k in range(count)) + "\n",
        4: "f 1 2 4 3 1 5\n" * count,
        5: "v 0 0 0\nf -1 -2 -3\n" * count,
        6: "\n" * (10 * count),
        7: f"v {'9' * 10 * count} 0 0\n",
        8: f"f 1 2 {_pick(rng, _HUGE)}\n",
        9: f"f 1 2 {-_pick(rng, _HUGE)}\n",
        10: "\\\n" * count,
        11: "v " + "1 " * count + "\n",
        12: "".join(f"usemtl m{k}\nv 0 0 {k}\nv 1 0 0\nv 0 1 0\nf -1 -2 -3\n" for k in range(count)),
    }[int(kind)]
    (folder / "room.obj").write_text(obj_text(faces))
    (folder / "room.mtl").write_text(MTL + "".join(f"newmtl m{k}\nKd 0 0 {k % 10 / 10}\n" for k in range(count)))
    (folder / "paper.png").write_bytes(encoded("PNG"))
    return folder / "room.obj"


def make_materials(rng: np.random.Generator, folder: Path) -> Path:
    """Every material of many has the same large texture."""
    count = int(_pick(rng, (100, 20_000)))
    names = "".join(f"newmtl m{k}\nmap_Kd paper.png\n" for k in range(count))
    (folder / "room.mtl").write_text(MTL + names)
    (folder / "room.obj").write_text(obj_text("".join(f"usemtl m{k}\nf 1/1 2/2 3/3\n" for k in range(count))))
    (folder / "paper.png").write_bytes(plain_png(4096, 4096))
    return folder / "room.obj"


def make_polygons(rng: np.random.Generator, folder: Path) -> Path:
    """One polygon that is as hard to cut as can be."""
    count = int(_pick(rng, (1000, 20_000, 100_000)))
    angle = np.linspace(0, 40 * np.pi * rng.random(), count)
    radius = 1 + (rng.random(count) if rng.random() < 0.5 else np.arange(count) % 2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)], axis=1)
    rows = "\n".join(f"v {x:.6f} {y:.6f} {z:.0f}" for x, y, z in points)
    (folder / "room.obj").write_text(obj_text(f"{rows}\nf {' '.join(str(9 + k) for k in range(count))}\n"))
    return folder / "room.obj"


# PLY


def make_ply_headers(rng: np.random.Generator, folder: Path) -> Path:
    data = ply_text(_pick(rng, ("ascii", "binary_little_endian", "binary_big_endian")))
    count = str(_pick(rng, (*_HUGE, -1, "1e9", "9" * 5000, "NaN", ""))).encode()
    data = _pick(
        rng,
        (
            data.replace(b"vertex 8", b"vertex " + count),
            data.replace(b"face 6", b"face " + count),
            data.replace(b"element vertex 8", b"element extra " + count + b"\nelement vertex 8"),
            data.replace(b"element vertex 8", b"element extra " + count + b"\nproperty list uint double a\n"
                         b"element vertex 8"),
            data.replace(b"uchar int", _pick(rng, (b"double int", b"int double", b"uint uint", b"char char"))),
            data.replace(b"property float x", b"".join(b"property float a%d\n" % k for k in range(20_000))),
            data.replace(b"element face", b"".join(b"element a%d 0\n" % k for k in range(20_000)) + b"element face"),
            data.replace(b"end_header", b""),
            data.replace(b"comment", b"comment " + b"x" * 1_000_000),
        ),
    )  # fmt: skip
    (folder / "a.ply").write_bytes(data)
    return folder / "a.ply"


def make_ply_bodies(rng: np.random.Generator, folder: Path) -> Path:
    data = ply_text() if rng.random() < 0.7 else ply_text("binary_little_endian")
    count = int(_pick(rng, (10_000, 1_000_000, 5_000_000)))
    data += _pick(rng, (b"\n" * count, b"0 " * count, b"9" * count, b"1\n" * count))
    if rng.random() < 0.3:
        data = data.replace(b"face 6", b"face %d" % count)
    (folder / "a.ply").write_bytes(data)
    return folder / "a.ply"


def make_ply_lists(rng: np.random.Generator, folder: Path) -> Path:
    data = bytearray(ply_text("binary_little_endian").replace(b"list uchar", b"list uint"))
    at = data.index(b"end_header") + 11 + 96
    data[at : at + 1] = struct.pack("<I", int(_pick(rng, (0, 5, 2**16, 2**31, 2**32 - 1))))
    (folder / "a.ply").write_bytes(data)
    return folder / "a.ply"


# STL


def make_stl(rng: np.random.Generator, folder: Path) -> Path:
    count = int(_pick(rng, (1000, 20_000, 100_000)))
    data = _pick(
        rng,
        (
            stl_binary()[:80] + struct.pack("<I", _pick(rng, (10**6, 2**31, 2**32 - 1))) + stl_binary()[84:],
            stl_text() + b"solid a\nendsolid a\n" * count,
            b"".join(stl_text().replace(b"room", b"r%d" % k) for k in range(count // 100)),
            b"".join(b"solid s\nvertex 0 0 %d\nvertex 1 0 0\nvertex 0 1 0\nendsolid s\n" % k for k in range(count)),
            stl_text().replace(b"vertex", b"vertex " + b"9" * 100_000, 1),
            b"solid " * count,
            b"endsolid " * count + b"solid",
        ),
    )
    (folder / "a.stl").write_bytes(data)
    return folder / "a.stl"


# COLLADA


def make_dae_nodes(rng: np.random.Generator, folder: Path) -> Path:
    levels, copies = _fan_out(rng)
    loop = rng.random() < 0.3
    library = "".join(
        f'<node id="n{k}">' + f'<instance_node url="#n{0 if loop else k + 1}"/>' * copies + "</node>"
        for k in range(levels)
    )
    library += f'<node id="n{levels}"><instance_geometry url="#walls"/></node>'
    (folder / "a.dae").write_text(dae_text(library=library, nodes='<node><instance_node url="#n0"/></node>'))
    return folder / "a.dae"


def make_dae_instances(rng: np.random.Generator, folder: Path) -> Path:
    count = int(_pick(rng, (1000, 100_000)))
    long = "<translate>0 0 0</translate>" * int(_pick(rng, (1, 3000)))
    library = f'<node id="x">{long}<instance_geometry url="#walls"/></node>'
    nodes = '<instance_node url="#x"/>' * count + '<instance_geometry url="#walls"/>' * (count // 2)
    (folder / "a.dae").write_text(dae_text(library=library, nodes=f"<node>{nodes}</node>"))
    return folder / "a.dae"


def make_dae_counts(rng: np.random.Generator, folder: Path) -> Path:
    huge = str(_pick(rng, (*_HUGE, -1, 0, "NaN", "1e9", "")))
    text = dae_text()
    old, new = _pick(
        rng,
        (
            ("<vcount>4 4", f"<vcount>{huge} 4"), ("<vcount>4 4", f"<vcount>4 {huge}"),
            ('stride="3"', f'stride="{huge}"'),
            ('offset="1"', f'offset="{huge}"'), ('count="8" stride="3"', f'count="{huge}" stride="3" offset="{huge}"'),
            ('meter="1"', f'meter="{huge}"'), ('set="0"', f'set="{huge}"'), ("<p>", f"<p>{huge} "),
            ("0 0 1 90", f"0 0 {huge} {huge}"), ("<scale>0.3", f"<scale>{huge}"), ("0 0 0<", f"{huge} {huge} {huge}<"),
        ),
    )  # fmt: skip
    (folder / "a.dae").write_text(text.replace(old, new))
    return folder / "a.dae"


def make_dae_lengths(rng: np.random.Generator, folder: Path) -> Path:
    count = int(_pick(rng, (10_000, 300_000)))
    quads = " ".join(map(str, QUADS.reshape(-1)))
    more = _pick(
        rng,
        (
            '<polygons><input semantic="VERTEX" source="#v" offset="0"/>' + "<p>0 1 3 2</p>" * count + "</polygons>",
            '<polygons><input semantic="VERTEX" source="#v" offset="0"/>'
            + "<ph><p>0 1 3 2</p></ph>" * (count // 100)
            + "</polygons>",
            "<polygons>" + '<input semantic="VERTEX" source="#v" offset="0"/>' * count + "<p>0 1 3 2</p></polygons>",
            f'<tristrips><input semantic="VERTEX" source="#v" offset="0"/><p>{"0 1 2 3 " * count}</p></tristrips>',
            f'<triangles><input semantic="VERTEX" source="#v" offset="0"/><p>{quads}</p></triangles>' * (count // 100),
            "<a>" * count + "</a>" * count,
            "<a/>" * (5 * count),
            "<a " + " ".join(f"b{k}='0'" for k in range(count // 10)) + "/>",
        ),
    )
    (folder / "a.dae").write_text(dae_text(more=more))
    return folder / "a.dae"


def make_entities(rng: np.random.Generator, folder: Path) -> Path:
    levels = "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(int(_pick(rng, (6, 12)))))
    kind = rng.integers(4)
    doctype, use = {
        0: (f'<!ENTITY l0 "lol">{levels}', "&l6;"),
        1: (f'<!ENTITY a "{"x" * 100_000}">', "&a;" * 20_000),
        2: ('<!ENTITY a SYSTEM "file:///dev/zero">', "&a;"),
        3: ('<!ENTITY % p SYSTEM "file:///dev/zero"> %p;', ""),
    }[int(kind)]
    text = dae_text().replace("<COLLADA", f"<!DOCTYPE x [{doctype}]><COLLADA").replace("0.8 0.2 0.2", f"0.8 0.2 {use}")
    (folder / "a.dae").write_text(text)
    return folder / "a.dae"


# The file itself


def make_special_files(rng: np.random.Generator, folder: Path) -> Path:
    suffix = _pick(rng, (".glb", ".gltf", ".obj", ".ply", ".stl", ".dae"))
    path = folder / f"a{suffix}"
    kind = rng.integers(5)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to(_pick(rng, _DEVICES))
    elif kind == 2:
        path.mkdir()
    elif kind == 3:
        path.write_bytes(b"")
    else:
        with open(path, "wb") as stream:
            stream.truncate(int(_pick(rng, (1 << 20, 100 << 20, 5 << 30))))
    return path


def make_names(rng: np.random.Generator, folder: Path) -> Path:
    name = _pick(
        rng,
        ("a\nb", "\x1b[31mred", "a\udcffb", "x" * 240, "a\tb", "a\r", "\u2028", "[red]a", "a?b=c", "<b>", "'", " "),
    )
    path = folder / f"{name}.obj"
    path.write_text(obj_text())
    return path


def make_extents(rng: np.random.Generator, folder: Path) -> Path:
    """A hall as large as a scene may be, or much larger."""
    gltf = Gltf()
    side = float(_pick(rng, (199.0, 1e6, 1e30)))
    corners = (gltf_corners() / gltf_corners().max(axis=0) * side).astype(np.float32)
    attributes = {"POSITION": gltf.accessor(corners)}
    primitive = {"attributes": attributes, "indices": gltf.accessor(FACES.astype(np.uint16).reshape(-1))}
    gltf.header |= {"meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0}]}
    return gltf.write(folder / "a.glb")


def make_base64(rng: np.random.Generator, folder: Path) -> Path:
    gltf = gltf_room()
    text = base64.b64encode(gltf.data.ljust(2 << 20)).decode()
    gltf.header["buffers"] = [{"byteLength": 2**40, "uri": f"data:application/octet-stream;base64,{text}"}] * 5
    return gltf.write(folder / "a.gltf")
