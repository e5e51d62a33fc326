"""PLY and STL files that ask for much: headers, lists, bodies that end too soon."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from tests.fuzz._bomb_sizes import HUGE, pick
from tests.fuzz._rooms import ply_text, stl_binary, stl_text


def make_ply_headers(rng: np.random.Generator, folder: Path) -> Path:
    data = ply_text(pick(rng, ("ascii", "binary_little_endian", "binary_big_endian")))
    count = str(pick(rng, (*HUGE, -1, "1e9", "9" * 5000, "NaN", ""))).encode()
    data = pick(
        rng,
        (
            data.replace(b"vertex 8", b"vertex " + count),
            data.replace(b"face 6", b"face " + count),
            data.replace(b"element vertex 8", b"element extra " + count + b"\nelement vertex 8"),
            data.replace(b"element vertex 8", b"element extra " + count + b"\nproperty list uint double a\n"
                         b"element vertex 8"),
            data.replace(b"uchar int", pick(rng, (b"double int", b"int double", b"uint uint", b"char char"))),
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
    count = int(pick(rng, (10_000, 1_000_000, 5_000_000)))
    data += pick(rng, (b"\n" * count, b"0 " * count, b"9" * count, b"1\n" * count))
    if rng.random() < 0.3:
        data = data.replace(b"face 6", b"face %d" % count)
    (folder / "a.ply").write_bytes(data)
    return folder / "a.ply"


def make_ply_lists(rng: np.random.Generator, folder: Path) -> Path:
    data = bytearray(ply_text("binary_little_endian").replace(b"list uchar", b"list uint"))
    at = data.index(b"end_header") + 11 + 96
    data[at : at + 1] = struct.pack("<I", int(pick(rng, (0, 5, 2**16, 2**31, 2**32 - 1))))
    (folder / "a.ply").write_bytes(data)
    return folder / "a.ply"


def make_stl(rng: np.random.Generator, folder: Path) -> Path:
    count = int(pick(rng, (1000, 20_000, 100_000)))
    data = pick(
        rng,
        (
            stl_binary()[:80] + struct.pack("<I", pick(rng, (10**6, 2**31, 2**32 - 1))) + stl_binary()[84:],
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
