"""Pictures that ask for much: of one colour, with another size in the header, many, or no files at all."""

from __future__ import annotations

import io
import struct
import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from tests.fuzz._bomb_sizes import DEVICES, pick, put_devices
from tests.fuzz._rooms import MTL, dae_text, encoded, gltf_room, obj_text, ply_text


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
    side = int(pick(rng, (8193, 13_000, 30_000, 65_535, 2**31 - 1)))
    kind = rng.integers(9)
    if kind < 3:
        name = str(pick(rng, ("PNG", "GIF", "BMP", "TGA", "JPEG")))
        return forged(encoded(name), name, side)
    if kind == 3:
        return plain_png(int(pick(rng, (4096, 8192, 9000))), int(pick(rng, (8192, 9000))))
    if kind == 4:
        bomb = zlib.compress(bytes(50 << 20))
        text = pick(rng, ((b"zTXt", b"a\0\0"), (b"iCCP", b"a\0\0"), (b"iTXt", b"a\0\1\0\0\0")))
        chunk = (text[0], text[1] + bomb)
        return png_of((b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0)), *[chunk] * 20, (b"IEND", b""))
    if kind == 5:
        return encoded(pick(rng, ("EPS", "PDF", "ICO", "PPM", "SGI", "PCX", "DDS", "XBM", "IM", "MPO", "AVIF")))
    if kind == 6:
        jpeg = encoded("JPEG", (64, 64), progressive=True)
        scan = jpeg[jpeg.index(b"\xff\xda") : jpeg.rindex(b"\xff\xd9")]
        return _forged_progressive(jpeg[:-2] + scan * int(pick(rng, (5, 2000))) + jpeg[-2:], side)
    if kind == 7:
        stream = io.BytesIO()
        Image.new("1", (int(pick(rng, (4096, 16_000))), 4096)).save(stream, "TIFF", compression="group4")
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
    side, count = pick(rng, ((13_000, 60), (8192, 60), (4096, 60), (512, 4000)))
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
    put_devices(folder)
    name = pick(rng, (*DEVICES, "pipe", "zero", "kernel", ".", "x" * 5000, "a\0b", "../../../../etc/passwd", "~/x.png"))
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
