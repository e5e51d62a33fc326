"""Write the fused TSDF surface of a map as a triangle mesh with the map's colours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.export.dataset import seed_points
from activestructure_gym.evaluation.protocols import CameraPath, StandardProtocol
from activestructure_gym.files import replaced
from activestructure_gym.geometry import PinholeCamera, invert_rigid, transform_points
from activestructure_gym.mapping.axes import FILE_FROM_WORLD, UpInFile

if TYPE_CHECKING:
    import trimesh

    from activestructure_gym.evaluation.archive.store import Run
    from activestructure_gym.mapping import GaussianMap

_SAME_M = 1e-5  # metres; corners of neighbouring triangles that are closer become one vertex
_SHOWN_M = 0.05  # metres; a rendering shows a vertex if its depth there differs by less


def surface_mesh(run: Run) -> trimesh.Trimesh:
    """Return the surface that the protocol ``standard`` measures, with vertex colours; metres, z up.

    The surface is fused from depth images of the map at the keyframes, and the colours come from its colour images
    there. Raise `InputError` if the map has no surface, or one that is too large.
    """
    import trimesh

    protocol = run.job.conditions.protocol
    if not isinstance(protocol, StandardProtocol):
        protocol = StandardProtocol()
    path = CameraPath.from_arrays(run.trajectory)
    corners = replace(protocol, points_source="both").surface(run.gaussians, path).oriented().reshape(-1, 3)
    if not len(corners):
        raise InputError(f"the map of '{run.directory}' shows no surface at its keyframes: there is no mesh to write")
    _, first, rows = np.unique(
        np.round(corners / _SAME_M).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    faces = rows.reshape(-1, 3)
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    vertices = corners[first]
    width = protocol.tsdf_image_width
    camera = path.camera.resized(width, round(width * path.camera.height / path.camera.width))
    colors = _colors_at(vertices, run.gaussians, camera, path.keyframes)
    return trimesh.Trimesh(vertices, faces[proper], vertex_colors=colors, process=False)


def write_mesh(mesh: trimesh.Trimesh, file: Path, up: UpInFile) -> None:
    """Write a mesh with vertex colours (z up) to a ``.glb`` or ``.ply`` file, turned so that ``up`` is the up axis.

    glTF's vertex colours are linear light, so a ``.glb`` has converted colours and a material without shading. A
    ``.ply`` has display colours. An existing file is replaced only when the new one is complete.
    """
    mesh = mesh.copy()
    mesh.vertices = mesh.vertices @ FILE_FROM_WORLD[up].T
    with replaced(file) as stream:
        if file.suffix.lower() == ".ply":
            content: Any = mesh.export(file_type="ply")
        else:
            content = _glb(mesh)
        stream.write(content)


def _glb(mesh: trimesh.Trimesh) -> bytes:
    import trimesh

    from activestructure_gym.scenes.loaders.mesh_parts import linear_from_srgb

    visual: Any = mesh.visual
    colors = linear_from_srgb(visual.vertex_colors[:, :3] / 255.0).astype(np.float32)
    # trimesh itself writes colours of 8 bits, too few for dark linear light.
    attributes: dict[str, Any] = {"_COLOR": colors}
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_attributes=attributes, process=False)
    return bytes(trimesh.exchange.gltf.export_glb(plain.scene(), include_normals=False, tree_postprocessor=_unlit))


def _unlit(tree: dict[str, Any]) -> None:
    """Name the colours as glTF does, and give the mesh a material that is shown without lights, from both sides."""
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            attributes["COLOR_0"] = attributes.pop("_COLOR")
            primitive["material"] = 0
    plain = {"baseColorFactor": [1.0, 1.0, 1.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0}
    unlit: dict[str, Any] = {"KHR_materials_unlit": {}}
    tree["materials"] = [{"pbrMetallicRoughness": plain, "doubleSided": True, "extensions": unlit}]
    tree["extensionsUsed"] = sorted({*tree.get("extensionsUsed", ()), *unlit})


def _colors_at(
    points: np.ndarray, gaussians: GaussianMap, camera: PinholeCamera, poses: np.ndarray
) -> np.ndarray:  # [P, 3] uint8
    """Return the colours that the map's renderings at ``poses`` [K, 4, 4] show at ``points`` [P, 3] metres.

    Renderings are weighted by the inverse of the squared depth. A point that none of them shows has the colour of the
    nearest opaque Gaussian.
    """
    from activestructure_gym.splatting import cpu
    from activestructure_gym.splatting.surface_depth import surface_depth

    sums, weights = np.zeros((len(points), 3)), np.zeros(len(points))
    for pose, camera_from_world in zip(poses, invert_rigid(poses)):
        there = transform_points(camera_from_world, points)
        rows = np.flatnonzero(there[:, 2] > 0.0)
        column, row = np.floor(camera.project(there[rows])).T
        inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        rows, column, row = rows[inside], column[inside].astype(int), row[inside].astype(int)
        depth = surface_depth(gaussians.parameters, gaussians.count, camera, pose[None])[0, row, column]
        near = np.abs(depth - there[rows, 2]) < _SHOWN_M
        rows, column, row = rows[near], column[near], row[near]
        color = cpu.render(gaussians.parameters, gaussians.count, camera, pose).color[row, column]
        weight = 1.0 / there[rows, 2] ** 2
        sums[rows] += weight[:, None] * color
        weights[rows] += weight
    hidden = weights == 0.0
    sums[~hidden] /= weights[~hidden, None]
    means, colors = seed_points(gaussians)
    if hidden.any() and len(means):
        sums[hidden] = colors[cKDTree(means).query(points[hidden])[1]] / 255.0
    return np.rint(255.0 * np.clip(sums, 0.0, 1.0)).astype(np.uint8)
