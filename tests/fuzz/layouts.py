"""Damaged folders: scenes of seven data sets and posed RGB-D sequences."""

from __future__ import annotations

import io
import json
import os
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from tests.fuzz._bombs_pictures import forged, plain_png
from tests.fuzz._mutations import damaged_bytes, damaged_json, damaged_text
from tests.fuzz._rooms import CORNERS, QUADS, load, rooms

CI_CASES = 100
_ENTRANCES = (
    "room",
    "room/habitat",
    "room/habitat/replica.stage_config.json",
    "replica:seq/room",
    "house/h1",
    "scan/scene0000_00",
    "scanpp/a1",
    "hm3d/00001-h1",
    "procthor:house.json",
    "data.scene_dataset_config.json",
    "hab/s.stage_config.json",
    "redwood",
    "tum",
)
_CAMERA = {"w": 40, "h": 24, "fx": 20.0, "fy": 20.0, "cx": 19.5, "cy": 11.5, "scale": 6553.5}


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    files = dict(layout())
    for _ in range(int(rng.integers(1, 3))):
        name = str(rng.choice(list(files)))
        files[name] = _damaged(rng, name, files[name])
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    if rng.random() < 0.15:
        _misplaced(rng, folder / str(rng.choice(list(files))))
    entrance = str(rng.choice(_ENTRANCES))
    sequence = "replica" if entrance == "room" and rng.random() < 0.5 else ""
    return lambda: _read(folder, entrance, sequence)


def _read(folder: Path, entrance: str, sequence: str) -> None:
    from activestructure_gym.evaluation.protocols.held_out_views import recorded_views
    from activestructure_gym.evaluation.trajectories.formats import read_poses
    from activestructure_gym.scenes import load_scene, load_sequence

    kind, colon, place = entrance.partition(":")
    if entrance in ("redwood", "tum"):
        frame = load_sequence(folder / entrance).frame(0)
        assert np.isfinite(frame.world_from_camera).all()
        return
    if (folder / entrance / "pose").exists():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read_poses(folder / entrance)
    if sequence:
        scene = load_scene(str(folder / entrance), sequence=str(folder / "seq" / "room"))
    elif colon:
        scene = load_scene(f"{kind}:{folder / place}")
    else:
        load(folder / entrance)
        scene = load_scene(str(folder / entrance))
    if scene.evaluation_views is not None:
        views = recorded_views(scene, count=3)
        assert np.isfinite(views.depth).all() and np.isfinite(views.world_from_camera).all()


@lru_cache(maxsize=1)
def layout() -> dict[str, bytes]:
    """All files by their path."""
    vertex = np.zeros(8, [("p", "<f4", 3), ("c", "u1", 3)])
    vertex["p"], vertex["c"] = CORNERS, (CORNERS * 50 % 256).astype(np.uint8)
    face = np.zeros(6, [("count", "u1"), ("corners", "<i4", 4), ("object", "<i4")])
    face["count"], face["corners"], face["object"] = 4, QUADS, [7, 7, 7, 7, 3, 9]
    header = ["ply", "format binary_little_endian 1.0", "element vertex 8"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += ["element face 6", "property list uchar int vertex_indices", "property int object_id", "end_header\n"]
    mesh = "\n".join(header).encode() + vertex.tobytes() + face.tobytes()
    objects = [{"id": k, "class_id": k, "class_name": name} for k, name in ((7, "wall"), (3, "floor"), (9, "lamp"))]
    pose = "1 0 0 2 0 0 1 1.5 0 -1 0 1.2 0 0 0 1"
    files = {
        "room/mesh.ply": mesh,
        "room/habitat/mesh_semantic.ply": mesh,
        "room/habitat/info_semantic.json": json.dumps({"classes": [], "objects": objects}).encode(),
        "room/habitat/replica.stage_config.json": json.dumps(
            {"render_asset": "../mesh.ply", "semantic_asset": "mesh_semantic.ply"}
        ).encode(),
        "seq/room_mesh.ply": mesh,
        "seq/cam_params.json": json.dumps({"camera": _CAMERA}).encode(),
        "seq/room/traj.txt": (pose + "\n").encode() * 3,
        "house/h1/h1.glb": rooms()["glb"]["room.glb"],
        "house/h1/h1.house": b"ASCII 1.1\n",
    }
    wall = {
        "polygon": [{"x": x, "y": y, "z": 0} for x, y in ((0, 0), (4, 0), (4, 2.5), (0, 2.5))],
        "id": "w",
        "roomId": "r",
    }
    floor = [{"x": x, "y": 0, "z": z} for x, z in ((0, 0), (0, 3), (4, 3), (4, 0))]
    chair = {"assetId": "Chair_007_1", "position": {"x": 2, "y": 0.5, "z": 1}, "rotation": {"x": 0, "y": 90, "z": 0}}
    files |= {
        "scan/scene0000_00/scene0000_00_vh_clean_2.ply": mesh,
        "scan/scene0000_00/scene0000_00.txt": b"axisAlignment = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n",
        "scan/scene0000_00/pose/0.txt": (pose + "\n").encode(),
        "scan/scene0000_00/pose/1.txt": b"-inf " * 16,
        "scanpp/a1/scans/mesh_aligned_0.05.ply": mesh,
        "hm3d/00001-h1/h1.glb": rooms()["glb"]["room.glb"],
        "house.json": json.dumps(
            {"rooms": [{"id": "r", "floorPolygon": floor}], "walls": [wall], "objects": [chair]}
        ).encode(),
        "data.scene_dataset_config.json": json.dumps(
            {"stages": {"paths": {".json": ["hab"]}},
             "objects": {"paths": {".json": ["hab"]},
                         "configs": [{"original_file": "hab/o.object_config.json", "template_handle": "p",
                                      "attributes": {"scale": [1, 2, 1]}}]},
             "scene_instances": {"paths": {".json": ["hab"]}}}
        ).encode(),
        "hab/s.stage_config.json": json.dumps({"render_asset": "room.glb", "up": [0, 1, 0]}).encode(),
        "hab/o.object_config.json": json.dumps({"render_asset": "room.glb", "units_to_meters": 0.1}).encode(),
        "hab/one.scene_instance.json": json.dumps(
            {"stage_instance": {"template_name": "s"},
             "object_instances": [{"template_name": name, "translation": [1, 0, 1], "rotation": [1, 0, 0, 0]}
                                  for name in "op"]}
        ).encode(),
        "hab/room.glb": rooms()["glb"]["room.glb"],
    }  # fmt: skip
    matrix = "\n".join([" ".join(pose.split()[4 * row : 4 * row + 4]) for row in range(4)])
    camera = {"width": 40, "height": 24, "intrinsic_matrix": [20.0, 0, 0, 0, 20.0, 0, 19.5, 11.5, 1]}
    files["redwood/trajectory.log"] = "".join(f"{n} {n} {n + 1}\n{matrix}\n" for n in range(2)).encode()
    files["redwood/camera.json"] = files["tum/camera.json"] = json.dumps(camera).encode()
    files["tum/groundtruth.txt"] = b"# pose\n0 2 1.5 1.2 0 0 0 1\n1 2 1.5 1.2 0 0 0 1\n"
    files["tum/rgb.txt"], files["tum/depth.txt"] = (
        b"0 rgb/0.png\n1 rgb/1.png\n",
        b"0.01 depth/0.png\n1.01 depth/1.png\n",
    )
    for index in range(2):
        for place, colour in (("redwood", "color"), ("tum", "rgb")):
            files[f"{place}/{colour}/{index}.png"] = _image("PNG", np.full((24, 40, 3), 80 + index, np.uint8))
            files[f"{place}/depth/{index}.png"] = _image("PNG", np.full((24, 40), 900 + index, np.uint16))
    for index in range(3):
        files[f"seq/room/results/frame{index:06d}.jpg"] = _image("JPEG", np.full((24, 40, 3), 80 + index, np.uint8))
        files[f"seq/room/results/depth{index:06d}.png"] = _image("PNG", np.full((24, 40), 9000 + index, np.uint16))
    return files


def _image(kind: str, pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind)
    return stream.getvalue()


def _damaged(rng: np.random.Generator, name: str, data: bytes) -> bytes:
    if name.endswith(".json") and rng.random() < 0.8:
        try:
            return damaged_json(rng, data)
        except ValueError:  # damaged before
            return damaged_bytes(rng, data)
    if name.endswith((".txt", ".house", ".log")):
        return damaged_text(rng, data)
    if name.endswith(".ply") and rng.random() < 0.7:
        end = data.find(b"end_header")
        return damaged_text(rng, data[:end]) + data[end:]
    if name.endswith((".jpg", ".png")) and rng.random() < 0.4:
        kind = "JPEG" if name.endswith(".jpg") else "PNG"
        if len(data) > 40 and data[:2] in (b"\xff\xd8", b"\x89P"):
            side = int(rng.choice([41, 4000, 30_000, 65_535]))
            return forged(data, kind, side) if rng.random() < 0.8 else plain_png(8192, 9000)
    return damaged_bytes(rng, data)


def _misplaced(rng: np.random.Generator, file: Path) -> None:
    """Something else stands where a file should be, or nothing."""
    file.unlink()
    kind = rng.integers(5)
    if kind == 0:
        os.mkfifo(file)
    elif kind == 1:
        file.mkdir()
    elif kind == 2:
        file.symlink_to("/dev/zero")
    elif kind == 3:
        file.with_name(f"frame{'²'}.png").write_bytes(b"")
