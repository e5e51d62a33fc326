"""Write the frames and the map of a run as data sets for offline training: COLMAP's text model, nerfstudio's JSON.

Both have PNG pictures in ``images/`` and depth in ``depth/``: 16-bit PNG, millimetres along the optical axis, 0 = no
surface. Both programs place the centre of the first pixel at (0.5, 0.5), as `PinholeCamera` does, so the intrinsics are
the camera's. Both files keep the run's world: metres, z up.

Sources: [schoenberger2016], pages "Output Format" and "Database Format" of COLMAP; [nerfstudio], page
"Data conventions" and the dataparser of this format.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from activestructure_gym.evaluation.export.frames import PosedFrames
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.geometry import invert_rigid
from activestructure_gym.geometry.rotations import quaternion_of
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.ply_header import BINARY_LITTLE_ENDIAN, PlyElement, PlyHeader, PlyProperty, header_bytes

DEPTH_FACTOR = 0.001  # metres per unit of the depth images
_MAX_DEPTH_M = 65.535  # largest depth of a 16-bit image in millimetres; farther pixels become 0
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # camera x right, y up, z backward
_SEED_POINTS = "sparse_pc.ply"
_DEPTH_NOTE = f"depth/: 16-bit PNG, factor {DEPTH_FACTOR} to metres along the optical axis, 0 = no surface"

Report = Callable[[int], object]  # called with the number of frames written so far


def write_colmap(frames: PosedFrames, gaussians: GaussianMap, folder: Path, report: Report = lambda done: None) -> None:
    """Write ``images/``, ``depth/`` and the text model ``sparse/0/`` into ``folder``.

    The model has one PINHOLE camera. Its points are the map's opaque means, without tracks.
    """
    names = _write_images(frames, folder, report)
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    camera = frames.camera
    lens = " ".join(map(repr, map(float, camera.lens)))
    _write_lines(
        model / "cameras.txt",
        f"# {_DEPTH_NOTE}",
        "# CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY",
        f"1 PINHOLE {camera.width} {camera.height} {lens}",
    )
    _write_lines(
        model / "images.txt",
        "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME (camera from world), then a line of 2D points: none",
        *_image_lines(frames.world_from_camera, names),
    )
    points, colors = seed_points(gaussians)
    _write_lines(
        model / "points3D.txt",
        "# POINT3D_ID X Y Z R G B ERROR TRACK: the opaque means of the map, without tracks",
        *(
            f"{number} {x:.9g} {y:.9g} {z:.9g} {red} {green} {blue} 0"
            for number, ((x, y, z), (red, green, blue)) in enumerate(zip(points.tolist(), colors.tolist()), start=1)
        ),
    )


def write_nerfstudio(
    frames: PosedFrames, gaussians: GaussianMap, folder: Path, report: Report = lambda done: None
) -> None:
    """Write ``images/``, ``depth/``, ``transforms.json`` and the points ``sparse_pc.ply`` into ``folder``.

    Poses are ``world_from_camera`` in metres with OpenGL axes of the camera. The file asks nerfstudio not to turn the
    world.
    """
    names = _write_images(frames, folder, report)
    camera = frames.camera
    poses = frames.world_from_camera @ _OPENGL_FROM_OPENCV
    content = {
        "camera_model": "OPENCV",
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "w": camera.width,
        "h": camera.height,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "orientation_override": "none",
        "applied_scale": 1.0,
        "depth_unit_scale_factor": DEPTH_FACTOR,
        "ply_file_path": _SEED_POINTS,
        "frames": [
            {"file_path": f"images/{name}", "depth_file_path": f"depth/{name}", "transform_matrix": pose.tolist()}
            for name, pose in zip(names, poses)
        ],
    }
    _write_lines(folder / "transforms.json", json.dumps(content, indent=1))
    _write_points(gaussians, folder / _SEED_POINTS)


def seed_points(gaussians: GaussianMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the means [P, 3] in metres and the colours [P, 3] uint8 of the Gaussians that count as reconstructed."""
    opaque = gaussians.opacities >= StandardProtocol.opacity_threshold
    colors = np.rint(255.0 * np.clip(gaussians.colors[opaque], 0.0, 1.0)).astype(np.uint8)
    return gaussians.means[opaque], colors


def _write_images(frames: PosedFrames, folder: Path, report: Report) -> list[str]:
    """Write colour and depth of all frames, and return the file names, which sort in the order of the frames."""
    for kind in ("images", "depth"):
        (folder / kind).mkdir()
    names = [f"frame_{number:06d}.png" for number in frames.numbers]
    for done, (name, (rgb, depth)) in enumerate(zip(names, frames.images(), strict=True), start=1):
        Image.fromarray(rgb).save(folder / "images" / name)
        near = np.where(depth <= _MAX_DEPTH_M, depth, 0.0)
        Image.fromarray(np.rint(near / DEPTH_FACTOR).astype(np.uint16)).save(folder / "depth" / name)
        report(done)
    return names


def _image_lines(poses: np.ndarray, names: list[str]) -> Iterator[str]:
    for number, (pose, name) in enumerate(zip(invert_rigid(poses), names), start=1):
        values = " ".join(repr(float(value)) for value in (*quaternion_of(pose[:3, :3]), *pose[:3, 3]))
        yield f"{number} {values} 1 {name}"
        yield ""  # also after the last image: readers skip every second line


def _write_points(gaussians: GaussianMap, file: Path) -> None:
    points, colors = seed_points(gaussians)
    columns = [(name, "float", "<f4") for name in "xyz"] + [(name, "uchar", "u1") for name in ("red", "green", "blue")]
    rows = np.empty(len(points), [(name, kind) for name, _, kind in columns])
    for name, values in zip((name for name, _, _ in columns), (*points.T, *colors.T)):
        rows[name] = values
    vertex = PlyElement("vertex", len(rows), tuple(PlyProperty(name, kind) for name, kind, _ in columns))
    header = header_bytes(PlyHeader(BINARY_LITTLE_ENDIAN, (vertex,)), ["world frame, z up, metres"])
    file.write_bytes(header + rows.tobytes())


def _write_lines(file: Path, *lines: str) -> None:
    file.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
