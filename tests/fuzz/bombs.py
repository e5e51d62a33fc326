"""Small files that ask for much: huge counts, doubled nodes, pictures of one colour, devices for files."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz import _bombs_gltf, _bombs_pictures, _bombs_text, _bombs_triangles
from tests.fuzz._bomb_sizes import DEVICES, pick
from tests.fuzz._bombs_gltf import gltf_corners
from tests.fuzz._rooms import FACES, Gltf, gltf_room, load, obj_text

CI_CASES = 15


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    made = {name: make for names in _SUBJECTS for name, make in names.items() if name.startswith("make_")}
    bombs = [make for _, make in sorted(made.items())]
    path = bombs[rng.integers(len(bombs))](rng, folder)
    options = {"up": "z"} if str(path).endswith((".glb", ".gltf")) else {}
    return lambda: load(path, **options)


def make_special_files(rng: np.random.Generator, folder: Path) -> Path:
    suffix = pick(rng, (".glb", ".gltf", ".obj", ".ply", ".stl", ".dae"))
    path = folder / f"a{suffix}"
    kind = rng.integers(5)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to(pick(rng, DEVICES))
    elif kind == 2:
        path.mkdir()
    elif kind == 3:
        path.write_bytes(b"")
    else:
        with open(path, "wb") as stream:
            stream.truncate(int(pick(rng, (1 << 20, 100 << 20, 5 << 30))))
    return path


def make_names(rng: np.random.Generator, folder: Path) -> Path:
    name = pick(
        rng,
        ("a\nb", "\x1b[31mred", "a\udcffb", "x" * 240, "a\tb", "a\r", "\u2028", "[red]a", "a?b=c", "<b>", "'", " "),
    )
    path = folder / f"{name}.obj"
    path.write_text(obj_text())
    return path


def make_extents(rng: np.random.Generator, folder: Path) -> Path:
    """A hall as large as a scene may be, or much larger."""
    gltf = Gltf()
    side = float(pick(rng, (199.0, 1e6, 1e30)))
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


_SUBJECTS = [globals(), *map(vars, (_bombs_gltf, _bombs_pictures, _bombs_text, _bombs_triangles))]
