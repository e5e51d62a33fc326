"""Damaged scene files of every format."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz._mutations import damaged_bytes, damaged_json, damaged_text
from tests.fuzz._rooms import glb_of, load, rooms

CI_CASES = 300
_TEXT = (".obj", ".mtl", ".dae", ".gltf")


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    kind = rng.choice(list(rooms()))
    files = dict(rooms()[kind])
    main = next(iter(files))
    spoilt = main if rng.random() < 0.8 else rng.choice(list(files))
    for _ in range(int(rng.integers(1, 3))):
        files[spoilt] = _damaged(rng, spoilt, kind, files[spoilt])
    for name, data in files.items():
        (folder / name).write_bytes(data)
    options = {"up": "z"} if kind == "placed" else {}
    return lambda: load(folder / main, **options)


def _damaged(rng: np.random.Generator, name: str, kind: str, data: bytes) -> bytes:
    text = name.endswith(_TEXT) or kind in ("ply", "stl")
    try:
        if name.endswith(".gltf") and rng.random() < 0.7:
            return damaged_json(rng, data)
        if name.endswith(".glb") and rng.random() < 0.7:
            return _damaged_header(rng, data)
    except (ValueError, struct.error):  # damaged before, and JSON no more
        pass
    if kind == "ply-binary" and rng.random() < 0.5:
        end = data.find(b"end_header")
        return damaged_text(rng, data[:end]) + data[end:]
    return damaged_text(rng, data) if text and rng.random() < 0.75 else damaged_bytes(rng, data)


def _damaged_header(rng: np.random.Generator, data: bytes) -> bytes:
    (length,) = struct.unpack_from("<I", data, 12)
    text = damaged_json(rng, data[20 : 20 + length])
    return glb_of(text + b" " * (-len(text) % 4), data[28 + length :])
