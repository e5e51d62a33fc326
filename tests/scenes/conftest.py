"""Small meshes that the tests of this room build from code, and a cache directory of their own."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.scenes.scene import Scene, SceneMesh


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory):
    """Nothing a test computes lands in the user's cache, and nothing stale from there is read."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ASG_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def box(low: Sequence[float], high: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """The twelve triangles of a box, wound inconsistently on purpose (every second one the other way)."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, d, c))]
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return low + corners * (high - low), np.array(faces)


def joined(*meshes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Several meshes as one."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def scene_of(vertices: np.ndarray, faces: np.ndarray, name: str = "test") -> Scene:
    """A grey scene."""
    mesh = SceneMesh(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        colors=np.full((len(vertices), 3), 0.7, np.float32),
        uv=np.zeros((len(vertices), 2), np.float32),
        face_texture=np.full(len(faces), -1, np.int32),
    )
    return Scene(name=name, mesh=mesh, source="test")


@pytest.fixture(scope="session")
def make_box() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    return box


@pytest.fixture(scope="session")
def join() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    return joined


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Scene]:
    return scene_of


@pytest.fixture(scope="session")
def furnished_room() -> Scene:
    """A room of 4 x 3 x 2.5 m with a closed wardrobe of 1 x 0.8 x 2 m in a corner and a table board in the middle."""
    return scene_of(
        *joined(
            box((0, 0, 0), (4, 3, 2.5)),
            box((0.02, 0.02, 0.0), (1.02, 0.82, 2.0)),
            box((1.8, 1.2, 0.7), (2.8, 2.0, 0.74)),
        ),
        name="furnished",
    )


class GltfWriter:
    """Builds a glTF file accessor by accessor, so that tests can use what exporters rarely write."""

    def __init__(self) -> None:
        self.header: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self.data = b""

    def view(self, data: bytes, **extra: Any) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.header["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **extra})
        self.data += data
        return len(self.header["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, **extra: Any) -> int:
        kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        shape = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[values.shape[1] if values.ndim == 2 else 1]
        self.header["accessors"].append(
            {
                "bufferView": self.view(np.ascontiguousarray(values).tobytes()),
                "componentType": kinds[values.dtype.str[1:]],
                "count": len(values),
                "type": shape,
                **extra,
            }
        )
        return len(self.header["accessors"]) - 1

    def triangle_mesh(self, vertices: np.ndarray, faces: np.ndarray, **primitive: Any) -> dict[str, Any]:
        """Add a mesh with one primitive; returns the primitive so that a test can add to it."""
        content = {
            "attributes": {"POSITION": self.accessor(vertices.astype(np.float32))},
            "indices": self.accessor(faces.astype(np.uint32).reshape(-1)),
            **primitive,
        }
        self.header.setdefault("meshes", []).append({"primitives": [content]})
        return content

    def write(self, path: Path) -> Path:
        self.header["buffers"] = [{"byteLength": len(self.data)}]
        self.header.setdefault("nodes", [{"mesh": k} for k in range(len(self.header.get("meshes", [])))])
        if path.suffix == ".gltf":
            self.header["buffers"][0]["uri"] = path.stem + ".bin"
            path.with_suffix(".bin").write_bytes(self.data)
            path.write_text(json.dumps(self.header))
            return path
        text = json.dumps(self.header).encode()
        text += b" " * (-len(text) % 4)
        binary = self.data + b"\0" * (-len(self.data) % 4)
        length = 12 + 8 + len(text) + 8 + len(binary)
        path.write_bytes(
            struct.pack("<4sII", b"glTF", 2, length)
            + struct.pack("<I4s", len(text), b"JSON") + text
            + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        )  # fmt: skip
        return path


@pytest.fixture
def gltf() -> GltfWriter:
    return GltfWriter()


def quad_ply(path: Path, vertices: np.ndarray, quads: np.ndarray, object_ids: np.ndarray | None = None) -> None:
    """A mesh as Replica writes it: binary little-endian quads with vertex colours, and object ids where given."""
    vertex = np.zeros(len(vertices), [("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 3)])
    vertex["p"], vertex["c"] = vertices, (np.abs(vertices) * 50 % 256).astype(np.uint8)
    fields: list[Any] = [("count", "u1"), ("corners", "<i4", quads.shape[1])]
    face = np.zeros(len(quads), fields if object_ids is None else [*fields, ("object_id", "<i4")])
    face["count"], face["corners"] = quads.shape[1], quads
    if object_ids is not None:
        face["object_id"] = object_ids
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices"]
    header += ["property int object_id"] if object_ids is not None else []
    path.write_bytes("\n".join([*header, "end_header\n"]).encode() + vertex.tobytes() + face.tobytes())


ROOM_SIZE = np.array([4.0, 3.0, 2.5])
ROOM_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
SEQUENCE_CAMERA = {"w": 40, "h": 24, "fx": 20.0, "fy": 20.0, "cx": 19.5, "cy": 11.5, "scale": 6553.5}


@pytest.fixture(scope="session")
def replica_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`room_a/` in Replica's layout and `seq/room_a/` in NICE-SLAM's: an empty box of 4 x 3 x 2.5 m.

    The depth images come from the closed form of a box and the SLAM convention (integer pixel centres), so nothing
    of the code under test made them.
    """
    import cv2

    root = tmp_path_factory.mktemp("replica")
    habitat = root / "room_a" / "habitat"
    habitat.mkdir(parents=True)
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * ROOM_SIZE
    object_ids = np.array([7, 7, 7, 7, 3, 9])  # four walls, the floor, the ceiling
    quad_ply(root / "room_a" / "mesh.ply", vertices, ROOM_QUADS)
    quad_ply(habitat / "mesh_semantic.ply", vertices, ROOM_QUADS, object_ids)
    names = {7: "wall", 3: "floor", 9: "lamp"}
    objects = [{"id": k, "class_id": k, "class_name": name} for k, name in names.items()]
    (habitat / "info_semantic.json").write_text(json.dumps({"classes": [], "objects": objects}))
    stage = {"render_asset": "../mesh.ply", "semantic_asset": "mesh_semantic.ply"}
    (habitat / "replica_stage.stage_config.json").write_text(json.dumps(stage))

    results = root / "seq" / "room_a" / "results"
    results.mkdir(parents=True)
    camera = SEQUENCE_CAMERA
    (root / "seq" / "cam_params.json").write_text(json.dumps({"camera": camera}))
    u, v = np.meshgrid(np.arange(camera["w"]), np.arange(camera["h"]))
    rays = np.stack([(u - camera["cx"]) / camera["fx"], (v - camera["cy"]) / camera["fy"], np.ones(u.shape)], axis=-1)
    lines = []
    for index, angle in enumerate((0.3, 2.0, 4.4)):
        forward = np.array([np.cos(angle), np.sin(angle), 0.0])
        right = np.array([np.sin(angle), -np.cos(angle), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, [0.0, 0.0, -1.0], forward], axis=1)
        pose[:3, 3] = (1.5, 1.2, 1.4)
        lines.append(" ".join(f"{value:.18e}" for value in pose.reshape(-1)))
        directions = rays @ pose[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            exits = np.where(directions > 0, (ROOM_SIZE - pose[:3, 3]) / directions, -pose[:3, 3] / directions)
        depth = np.round(np.nanmin(exits, axis=-1) * camera["scale"]).astype(np.uint16)
        cv2.imwrite(str(results / f"depth{index:06d}.png"), depth)
        rgb = np.full((camera["h"], camera["w"], 3), (200, 60, 10), np.uint8)
        cv2.imwrite(str(results / f"frame{index:06d}.jpg"), rgb[..., ::-1])
    (root / "seq" / "room_a" / "traj.txt").write_text("\n".join(lines) + "\n")
    return root
