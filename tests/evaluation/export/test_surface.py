"""The exported mesh is the surface of the map, in the axes and colours of its format."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.export import surface_mesh, write_mesh
from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol
from activestructure_gym.mapping import GaussianMap


@pytest.fixture(scope="module")
def mesh(run: Run) -> trimesh.Trimesh:
    return surface_mesh(run)


def test_it_is_the_surface_that_the_protocol_measures(run: Run, mesh: trimesh.Trimesh) -> None:
    protocol = run.job.conditions.protocol
    assert isinstance(protocol, StandardProtocol)
    pieces = protocol.surface(run.gaussians, CameraPath.from_arrays(run.trajectory)).pieces()
    corners = np.concatenate(list(pieces))
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(edges.astype(float), axis=1).sum()
    assert mesh.area == pytest.approx(area, rel=1e-3) and area > 1.0
    assert len(mesh.vertices) < 0.8 * len(mesh.faces)  # triangles share their corners


def test_the_normals_point_to_free_space(run: Run, mesh: trimesh.Trimesh) -> None:
    assert mesh.is_winding_consistent
    low, high = np.zeros(3), np.array([4.0, 3.0, 2.5])  # the box, seen from inside
    middles, normals, areas = mesh.triangles_center, mesh.face_normals, mesh.area_faces
    for axis in range(3):
        for wall, inward in ((low[axis], 1.0), (high[axis], -1.0)):
            own = (np.abs(middles[:, axis] - wall) < 0.03) & (np.abs(normals[:, axis]) > 0.8)
            if areas[own].sum() > 0.3:
                right = areas[own & (inward * normals[:, axis] > 0)].sum()
                assert right > 0.99 * areas[own].sum()


@pytest.mark.parametrize(("name", "up"), [("x.glb", "y"), ("x.glb", "z"), ("x.ply", "z"), ("x.PLY", "-y")])
def test_trimesh_reads_it(mesh: trimesh.Trimesh, tmp_path: Path, name: str, up: str) -> None:
    write_mesh(mesh, tmp_path / name, up)  # type: ignore[arg-type]
    read = trimesh.load(tmp_path / name, force="mesh", process=False)
    x, y, z = mesh.vertices.T
    wanted = {"z": (x, y, z), "y": (x, z, -y), "-y": (x, -z, y)}[up]
    np.testing.assert_allclose(read.vertices, np.stack(wanted, axis=1), atol=1e-6)
    np.testing.assert_array_equal(read.faces, mesh.faces)


def test_a_ply_has_display_colours(mesh: trimesh.Trimesh, tmp_path: Path) -> None:
    write_mesh(mesh, tmp_path / "x.ply", "z")
    read = trimesh.load(tmp_path / "x.ply", process=False)
    np.testing.assert_array_equal(read.visual.vertex_colors, mesh.visual.vertex_colors)


def test_a_glb_has_linear_colours_and_no_shading(mesh: trimesh.Trimesh, tmp_path: Path) -> None:
    write_mesh(mesh, tmp_path / "x.glb", "y")
    data = (tmp_path / "x.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    assert tree["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    begin = 28 + length + view["byteOffset"] + accessor.get("byteOffset", 0)
    linear = np.frombuffer(data, "<f4", 3 * accessor["count"], begin).reshape(-1, 3)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(255.0 * shown, mesh.visual.vertex_colors[:, :3], atol=0.01)


def test_colours_are_those_of_the_map(run: Run, mesh: trimesh.Trimesh) -> None:
    """Rays of the first keyframe meet a mesh whose corners have the colours that the map shows there."""
    from activestructure_gym.scenes.raycaster import RayCaster
    from activestructure_gym.splatting import cpu

    path = CameraPath.from_arrays(run.trajectory)
    pose = path.keyframes[0]
    shown = cpu.render(run.gaussians.parameters, run.gaussians.count, path.camera, pose).color.reshape(-1, 3)
    rays = (path.camera.rays().reshape(-1, 3) @ pose[:3, :3].T).astype(np.float32)
    hits = RayCaster(mesh.vertices, mesh.faces, threads=1).cast(pose[:3, 3].astype(np.float32), rays)
    met = np.isfinite(hits.distance)
    colors = mesh.visual.vertex_colors[mesh.faces[hits.face[met], 0], :3] / 255.0
    assert met.mean() > 0.8 and np.median(np.abs(colors - np.clip(shown[met], 0, 1))) < 0.05


def test_an_empty_map_has_no_mesh(run: Run) -> None:
    empty = dataclasses.replace(run)
    empty.__dict__["gaussians"] = GaussianMap(1)
    with pytest.raises(InputError, match="shows no surface"):
        surface_mesh(empty)
