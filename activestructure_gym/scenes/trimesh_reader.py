"""Reader for Wavefront OBJ, PLY and STL, through trimesh."""

from __future__ import annotations

import io
import logging
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.scenes.mesh_parts import PLAIN_GREY, MeshPart, TextureStore, find_reference, placed


def read_with_trimesh(path: Path, textures: TextureStore) -> list[MeshPart]:
    """All triangles of the file; quads and polygons are split, colours and textures kept."""
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # what matters of it is said by the loader
    source: Any = str(path)
    if path.suffix.lower() == ".obj":
        source = io.StringIO(_obj_text(path.read_bytes()))
    elif path.suffix.lower() == ".stl":
        _check_stl(path.read_bytes())
    with np.errstate(invalid="ignore"):  # what is not finite is reported by the loader
        scene = trimesh.load_scene(
            source, file_type=path.suffix[1:].lower(), process=False, resolver=_resolver(path, textures)
        )
    parts = []
    for node in scene.graph.nodes_geometry:
        world_from_node, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            parts.append(_part(geometry, world_from_node, textures))
    return parts


def _decoded(data: bytes) -> str:
    """Text in UTF-8, or in Latin-1 as older exporters write names; trimesh needs one more package for that."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _obj_text(data: bytes) -> str:
    if b"\0" in data:
        raise ValueError("it is a binary file and no OBJ text; is the suffix right?")
    return _decoded(data)


def _check_stl(data: bytes) -> None:
    """A binary STL has the length that its count of triangles says; anything else has to be text."""
    expected = 84 + 50 * int.from_bytes(data[80:84], "little")
    if len(data) < 84 or len(data) == expected or b"\0" not in data:
        return
    raise ValueError(f"it is neither text nor a whole binary STL ({len(data)} bytes where its header says {expected})")


def _resolver(path: Path, textures: TextureStore) -> Any:
    """Finds what the file refers to wherever that lies; trimesh's own stops at the mesh's folder and keeps silent."""
    from trimesh.resolvers import FilePathResolver

    class AnywhereResolver(FilePathResolver):
        def get(self, name: str) -> bytes:
            try:
                data = find_reference(path.parent, name).read_bytes()
                return _decoded(data).encode() if name.lower().endswith(".mtl") else data
            except OSError:
                textures.unreadable.append(name)
                raise

    return AnywhereResolver(str(path))


def _part(geometry: Any, world_from_node: np.ndarray, textures: TextureStore) -> MeshPart:
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    faces = np.asarray(geometry.faces)
    visual = geometry.visual
    colors: np.ndarray = np.full(3, PLAIN_GREY)
    uv, texture = None, -1
    if visual.kind == "vertex":
        colors = _srgb(visual.vertex_colors)
    elif visual.kind == "face":
        # A vertex can carry only one colour, so every face gets its own three.
        colors = np.repeat(_srgb(visual.face_colors), 3, axis=0)
        vertices, faces = vertices[faces.reshape(-1)], np.arange(3 * len(faces)).reshape(-1, 3)
    elif visual.kind == "texture":
        material = visual.material
        image = getattr(material, "image", None)
        if image is not None and visual.uv is not None and len(visual.uv) == len(vertices):
            texture = textures.add(id(image), lambda: image, str(getattr(material, "name", "texture")))
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


def _srgb(rgba: np.ndarray) -> np.ndarray:  # uint8 [..., 4] -> float [..., 3]
    return np.asarray(rgba, dtype=np.float64)[..., :3] / 255.0
