"""Reader for Wavefront OBJ, PLY and STL, through trimesh."""

from __future__ import annotations

import io
import logging
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.scenes.loaders.budget import LimitError
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.images import opened_image
from activestructure_gym.scenes.loaders.mesh_parts import (
    PLAIN_GREY,
    MeshPart,
    TextureStore,
    find_reference,
    placed,
)
from activestructure_gym.scenes.loaders.obj_text import plain_obj
from activestructure_gym.scenes.loaders.polygons import concave_corners, triangulated


def read_with_trimesh(path: Path, textures: TextureStore) -> list[MeshPart]:
    """All triangles of the file; quads and polygons are split, colours and textures kept."""
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # what matters of it is said by the loader
    data = textures.budget.read(path)
    source: Any = io.BytesIO(data)
    if path.suffix.lower() == ".obj":
        source = io.StringIO(_obj_text(data))
    elif path.suffix.lower() == ".stl":
        _check_stl(data)
    elif not data.startswith(b"ply"):
        raise UnreadableMesh("it does not begin with the letters 'ply'")
    try:
        with np.errstate(invalid="ignore"):  # what is not finite is reported by the loader
            scene = trimesh.load_scene(
                source, file_type=path.suffix[1:].lower(), process=False, resolver=_resolver(path, textures)
            )
    except ValueError as error:
        if "unexpected length" not in str(error):
            raise
        raise UnreadableMesh(
            "it is cut off, or its faces differ in their number of corners: triangulate it or export it as ASCII PLY"
        ) from error
    parts = []
    for node in scene.graph.nodes_geometry:
        world_from_node, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            parts.append(_part(geometry, world_from_node, textures))
    return parts


def _decoded(data: bytes) -> str:
    """Text in UTF-8, in UTF-16 that says so, or in Latin-1 as older exporters write names."""
    try:
        return data.decode("utf-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _obj_text(data: bytes) -> str:
    text = _decoded(data)
    if "\0" in text:
        raise UnreadableMesh("it is a binary file and no OBJ text, or UTF-16 without a mark: save it as UTF-8")
    return plain_obj(text)


def _check_stl(data: bytes) -> None:
    """A binary STL has the length that its count of triangles says; anything else has to be text."""
    expected = 84 + 50 * int.from_bytes(data[80:84], "little")
    if len(data) < 84 or len(data) == expected or b"\0" not in data:
        return
    raise UnreadableMesh(
        f"it is neither text nor a whole binary STL ({len(data)} bytes where its header says {expected})"
    )


def _resolver(path: Path, textures: TextureStore) -> Any:
    """Finds what the file refers to where `find_reference` looks; trimesh's own keeps silent about what is missing."""
    from trimesh.resolvers import FilePathResolver

    class NearbyResolver(FilePathResolver):
        def get(self, name: str) -> bytes:
            try:
                data = textures.budget.read(find_reference(path.parent, name))
                if name.lower().endswith(".mtl"):
                    return _decoded(data).encode()
                opened_image(data)  # trimesh would open any kind of picture
                return data
            except LimitError as error:
                textures.note_unreadable(f"{name}: {error}")
                raise
            except Exception:  # missing, or no picture: Pillow raises whatever the codec raises
                textures.note_unreadable(name)
                raise

    return NearbyResolver(str(path))


def _part(geometry: Any, world_from_node: np.ndarray, textures: TextureStore) -> MeshPart:
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    faces, polygon = _triangles(geometry)
    visual = geometry.visual
    colors: np.ndarray = np.full(3, PLAIN_GREY)
    uv, texture = None, -1
    if visual.kind == "vertex":
        colors = _srgb(visual.vertex_colors)
    elif visual.kind == "face":
        # A vertex can carry only one colour, so every face gets its own three.
        colors = np.repeat(_srgb(visual.face_colors)[polygon], 3, axis=0)
        vertices, faces = vertices[faces.reshape(-1)], np.arange(3 * len(faces)).reshape(-1, 3)
    elif visual.kind == "texture":
        material = visual.material
        image = getattr(material, "image", None)
        material_name = str(getattr(material, "name", "texture"))
        if image is not None and visual.uv is not None and len(visual.uv) == len(vertices):
            # Hundreds of materials may share one file: it is decoded once.
            texture = textures.add(("obj", image.info.get("file_path", id(image))), lambda: image, material_name)
        elif image is not None:
            textures.without_uv.append(material_name)
        if texture >= 0:
            uv = np.asarray(visual.uv, dtype=np.float64) * [1.0, -1.0] + [0.0, 1.0]
            # Exporters leave Kd at 0, 0.8 or 1 beside a map; what the author saw is the map.
            colors = np.ones(3)
        elif getattr(material, "diffuse", None) is not None and getattr(material, "name", None) is not None:
            colors = _srgb(np.asarray(material.diffuse))
    return MeshPart(
        vertices=placed(vertices, world_from_node),
        faces=faces,
        colors=colors,
        uv=uv,
        texture=texture,
    )


def _triangles(geometry: Any) -> tuple[np.ndarray, np.ndarray]:
    """Triangles [F, 3], ears instead of fans in concave polygons of a PLY file, and the file's face of each [F]."""
    faces = np.asarray(geometry.faces)
    sizes = _polygon_sizes(geometry.metadata.get("_ply_raw"))
    if not (sizes > 3).any() or (sizes - 2).sum() != len(faces) or faces.max() >= len(geometry.vertices):
        return faces, np.arange(len(faces))
    # trimesh puts triangles first, then the first and the second halves (c, d, a) of the quads, then all other fans.
    polygons = np.concatenate([np.flatnonzero(chosen) for chosen in (sizes == 3, sizes == 4, sizes > 4)])
    triangles, quads, sizes = (sizes == 3).sum(), (sizes == 4).sum(), sizes[polygons]
    halves = np.split(faces[triangles : triangles + 2 * quads], 2)
    in_order = faces.copy()
    in_order[triangles : triangles + 2 * quads : 2] = halves[0]
    in_order[triangles + 1 : triangles + 2 * quads : 2] = np.roll(halves[1], 1, axis=1)
    # The first triangle of a fan has three corners of its polygon, each other one adds its last.
    own = np.tile([False, False, True], (len(faces), 1))
    own[np.cumsum(sizes - 2) - (sizes - 2)] = True
    around = in_order[own]
    corners = np.asarray(geometry.vertices, dtype=np.float64)[around]
    if geometry.visual.kind != "face" and not len(concave_corners(corners, sizes)[0]):
        return faces, np.arange(len(faces))
    split, polygon = triangulated(corners, sizes)
    return around[split], polygons[polygon]


def _polygon_sizes(elements: Any) -> np.ndarray:  # [P] corners of each face of a PLY file, empty for other files
    data = (elements or {}).get("face", {}).get("data", {})
    names = data if isinstance(data, dict) else data.dtype.names or ()
    for name in ("vertex_index", "vertex_indices"):
        if name in names:
            lists = data[name] if isinstance(data, dict) else data[name]["f1"]
            return np.array([len(face) for face in lists]) if lists.ndim == 1 else np.full(len(lists), lists.shape[1])
    return np.zeros(0, np.int64)


def _srgb(rgba: np.ndarray) -> np.ndarray:  # uint8 [..., 4] -> float [..., 3]
    return np.asarray(rgba, dtype=np.float64)[..., :3] / 255.0
