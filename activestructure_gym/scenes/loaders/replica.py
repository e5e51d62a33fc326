"""Load Replica scenes in their published folder layout, with object labels if available.

Files: ``<scene>/mesh.ply`` (quads or triangles with vertex colours), ``<scene>/habitat/mesh_semantic.ply`` (the same
with an object id per face), ``<scene>/habitat/info_semantic.json`` (names of the ids) and
``<scene>/habitat/replica_stage.stage_config.json`` (which of them to use). Metres, z up. PTex textures (``textures/``),
glass surfaces and navmeshes are ignored. Source of the layout: [replica], its README and PLY parser.
"""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.ply_header import (
    BINARY_LITTLE_ENDIAN,
    NUMPY_ORDERS,
    NUMPY_TYPES,
    PlyElement,
    PlyHeader,
    PlyProperty,
    read_header,
)
from activestructure_gym.scenes.datasets import REPLICA, find_scene
from activestructure_gym.scenes.loaders.budget import LimitError, SceneBudget
from activestructure_gym.scenes.loaders.damage import UnreadableMesh, in_words
from activestructure_gym.scenes.loaders.json_files import read_json
from activestructure_gym.scenes.loaders.mesh_loader import check_mesh_file, finished_scene, painted
from activestructure_gym.scenes.loaders.mesh_parts import PLAIN_GREY, MeshPart, assemble, full_scale
from activestructure_gym.scenes.loaders.references import find_reference
from activestructure_gym.scenes.loaders.sequence import load_sequence
from activestructure_gym.scenes.loaders.upright import DeclaredUp, choose_up
from activestructure_gym.scenes.scene import PartLabels, Scene

# Replica's class names of the building; all other classes are objects.
STRUCTURAL_CLASSES = frozenset(("wall", "floor", "ceiling", "door", "window", "beam", "pillar", "stair"))

_OWN_FILES = ("habitat", "textures", "traj.txt", "semantic.json", "preseg.json", "glass.sur")  # next to mesh.ply
_FIRST_FACE = 256  # number of bytes read from the first face; they contain its number of corners


def load_replica_scene(path: str | os.PathLike[str], *, sequence: str | os.PathLike[str] | None = None) -> Scene:
    """Load a Replica scene.

    Parameters
    ----------
    path
        The scene's folder, its ``habitat`` folder, ``mesh.ply``, ``mesh_semantic.ply`` or the stage config json. Also
        its name (``office_0``) with the dataset's folder in ``ASG_REPLICA`` (see
        `activestructure_gym.scenes.datasets`), or a NICE-SLAM sequence folder with ``<folder>_mesh.ply`` or
        ``<folder>.ply`` next to it.
    sequence
        Folder of a posed RGB-D sequence of the scene (NICE-SLAM layout), used as its evaluation views.

    Raises
    ------
    InputError
        If the scene is missing, or a file is damaged.
    """
    path = find_scene(REPLICA, path)
    if path.name in ("", ".."):  # "." has a name too
        path = Path(os.path.abspath(path))
    mesh_file, root = _mesh_file(path)
    if (path / "traj.txt").is_file() and sequence is None:
        sequence = path
    views = load_sequence(sequence) if sequence is not None else None
    vertices, faces, colors, object_ids = _read_ply(mesh_file)
    if not np.isfinite(vertices).all():
        broken = int((~np.isfinite(vertices).all(axis=1)).sum())
        raise InputError(
            f"'{mesh_file}' has {broken} of {len(vertices)} vertices that are not finite (NaN or infinite); "
            "repair the mesh first"
        )
    mesh, doubts = painted(assemble([MeshPart(vertices, faces, colors)], ()))
    up = DeclaredUp("z", "in Replica", explicit=True)
    doubts += choose_up(mesh_file, vertices, faces, given=None, declared=up)[1]
    labels = None if object_ids is None else _labels(mesh_file.with_name("info_semantic.json"), object_ids)
    scene = finished_scene(mesh, mesh_file, name=root.name, labels=labels, doubts=doubts)
    return replace(scene, evaluation_views=views)


def is_replica(path: Path) -> bool:
    """Return whether the path is probably part of a Replica scene; it identifies paths without a loader prefix.

    Many tools name their mesh mesh.ply. Without other files of the dataset, it counts as Replica's only if it has
    quads.
    """
    if not path.is_dir():
        return path.name == "mesh_semantic.ply" or path.name.endswith(".stage_config.json")
    if any((path / name).is_file() for name in ("habitat/mesh_semantic.ply", "mesh_semantic.ply")):
        return True
    if not (path / "mesh.ply").is_file():
        return False
    named = REPLICA.folder_of(Path(os.path.abspath(path)).name) is not None
    return named or any((path / name).exists() for name in _OWN_FILES) or _has_quads(path / "mesh.ply")


def _has_quads(mesh_file: Path) -> bool:
    """Return whether this is a binary PLY whose first face is a quad."""
    try:
        with open(mesh_file, "rb") as file:
            vertices, faces = _elements(read_header(file))
            file.seek(vertices.count * _vertex_dtype(vertices).itemsize, os.SEEK_CUR)
            return _corner_count(file.read(_FIRST_FACE), 0, faces.properties) == 4
    except (ValueError, KeyError, OverflowError, OSError):
        return False


def _mesh_file(path: Path) -> tuple[Path, Path]:
    """Return the path of the mesh to read, and the path of the scene's folder, whose name is the name of the scene."""
    if path.name.endswith(".json"):
        return _from_stage_config(path)
    if not path.exists() and not REPLICA.meshes_beside(path):
        raise InputError(f"there is no Replica scene '{path}': neither such a folder nor such a file")
    if path.is_file():
        mesh_file = check_mesh_file(path)
        if mesh_file.suffix.lower() != ".ply":
            raise InputError(f"'{path}' is not a Replica mesh, which is a .ply file; load it as mesh:{path}")
        folder = mesh_file.parent
        return mesh_file, folder.parent if folder.name == "habitat" else folder
    for candidate, root in (
        (path / "mesh.ply", path),
        (path / "habitat" / "mesh_semantic.ply", path),
        (path / "mesh_semantic.ply", path.parent),
        *((mesh, path) for mesh in REPLICA.meshes_beside(path)),
    ):
        if candidate.is_file():
            return candidate, root
    if (path / "traj.txt").is_file():
        raise InputError(
            f"'{path}' is a posed sequence without a mesh; give the folder with mesh.ply and pass this one as sequence="
        )
    raise InputError(f"'{path}' is not a Replica scene: it has neither mesh.ply nor habitat/mesh_semantic.ply")


def _from_stage_config(path: Path) -> tuple[Path, Path]:
    if not path.is_file():
        raise InputError(f"there is no stage config '{path}'")
    config = read_json(path, "a stage config (JSON with render_asset)", lambda given: dict(given))
    assets = [config[key] for key in ("semantic_asset", "render_asset") if isinstance(config.get(key), str)]
    for asset in assets:  # the semantic mesh is the same surface, with labels
        if not asset.lower().endswith(".ply"):
            continue
        try:
            return _mesh_file(Path(os.path.normpath(find_reference(path.parent, asset))))
        except (FileNotFoundError, LimitError):
            continue
    raise InputError(
        f"'{path}' names no .ply mesh in its folder or the one above (render_asset, semantic_asset: "
        f"{short_repr(assets)})"
    )


def _read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Return vertices [V, 3], triangles [F, 3], colours [V, 3] or [3], and object id per triangle or None.

    Replica publishes binary PLY files whose faces are all triangles or all quads: plain arrays of records. Other files
    are refused. trimesh would read them, but loses the quad of each triangle.
    """
    budget = SceneBudget()
    try:
        data = budget.read(path)
        vertices_of, faces_of = _elements(read_header(stream := io.BytesIO(data)))
        start, vertex_count, face_count = stream.tell(), vertices_of.count, faces_of.count
        vertex_dtype = _vertex_dtype(vertices_of)
        face_start = start + vertex_count * vertex_dtype.itemsize
        if not face_count:
            raise UnreadableMesh("it has no faces")
        corners = _corner_count(data, face_start, faces_of.properties)
        fields: list[tuple] = []
        for one in faces_of.properties:
            if one.count_kind:
                fields += [("count", _number(one.count_kind)), ("corners", _number(one.kind), (corners,))]
            else:
                fields.append((one.name, _number(one.kind)))
        face_dtype = np.dtype(fields)
        if face_start + face_count * face_dtype.itemsize > len(data):
            raise UnreadableMesh(f"it is cut off: {vertex_count} vertices and {face_count} faces do not fit into it")
        budget.take("vertices", vertex_count)
        budget.take("triangles", face_count * (corners - 2))
        vertex = np.frombuffer(data, vertex_dtype, vertex_count, start)
        face = np.frombuffer(data, face_dtype, face_count, face_start)
        if (face["count"] != corners).any():
            raise UnreadableMesh("its faces are neither all triangles nor all quads")
        polygons = face["corners"].astype(np.int64)
        if polygons.min() < 0 or polygons.max() >= vertex_count:
            raise UnreadableMesh("its faces name vertices that do not exist")
        vertices = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(np.float64)
        colors = np.full(3, PLAIN_GREY)
        if "red" in (vertex_dtype.names or ()):
            colors = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
            colors = colors / full_scale([colors])
    except (ValueError, KeyError, IndexError, TypeError, OverflowError, OSError) as error:
        raise InputError(
            f"'{path}' is not a Replica mesh (binary PLY of quads or triangles): {in_words(error)}"
        ) from error
    # Quad (a, b, c, d) becomes (a, b, c) and (c, d, a), consecutively.
    faces = polygons if corners == 3 else polygons[:, [0, 1, 2, 2, 3, 0]].reshape(-1, 3)
    object_ids = None
    if face.dtype.names and "object_id" in face.dtype.names:
        object_ids = np.repeat(face["object_id"].astype(np.int64), 1 if corners == 3 else 2)
    return vertices, faces, colors, object_ids


def _elements(header: PlyHeader | None) -> tuple[PlyElement, PlyElement]:
    """Return the vertex and the face element of a header; raise `UnreadableMesh` if they do not come first."""
    if header is None or not header.complete and not header.unreadable:
        raise UnreadableMesh("it has no PLY header")
    if header.format not in ("", BINARY_LITTLE_ENDIAN):
        raise UnreadableMesh(f"its format is {header.format}, not {BINARY_LITTLE_ENDIAN}")
    if header.unreadable:
        raise UnreadableMesh(f"the line '{header.unreadable}' of its header cannot be read")
    names = [element.name for element in header.elements]
    if names[:2] != ["vertex", "face"]:
        raise UnreadableMesh(f"its elements are {', '.join(names) or 'none'}, not vertex and face")
    return header.elements[0], header.elements[1]


def _vertex_dtype(vertices: PlyElement) -> np.dtype:
    return np.dtype([(one.name, _number(one.kind)) for one in vertices.properties])


def _number(kind: str) -> str:
    """Return the numpy type of a PLY type name, in the byte order of Replica's files."""
    return NUMPY_ORDERS[BINARY_LITTLE_ENDIAN] + NUMPY_TYPES[kind]


def _corner_count(data: bytes, start: int, properties: Sequence[PlyProperty]) -> int:
    """Return the number of corners of the face at byte ``start``; raise `UnreadableMesh` unless it is 3 or 4."""
    for one in properties:
        if one.count_kind:
            corners = int(np.frombuffer(data, _number(one.count_kind), 1, start)[0])
            if corners not in (3, 4):
                raise UnreadableMesh(f"its first face has {corners} corners")
            return corners
        start += np.dtype(_number(one.kind)).itemsize
    raise UnreadableMesh("its faces have no list of vertices")


def _labels(info_file: Path, object_ids: np.ndarray) -> PartLabels:
    """Return the objects of a scene as labelled parts, sorted by id; ``object_ids`` [F] is the id of each triangle.

    Without the file of names, the parts are only numbered.
    """
    ids, face_part = np.unique(object_ids, return_inverse=True)
    names = {}
    if info_file.is_file():
        names = read_json(
            info_file,
            "Replica's info_semantic.json (objects, each with id and class_name)",
            lambda given: {int(entry["id"]): str(entry["class_name"]) for entry in given["objects"]},
        )
    return PartLabels(
        face_part=face_part.astype(np.int32),
        names=tuple(f"{names.get(int(i), 'object')} {i}" for i in ids),
        structural=np.array([names.get(int(i)) in STRUCTURAL_CLASSES for i in ids], dtype=bool),
    )
