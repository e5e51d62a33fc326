"""Collect shapes, materials and part names into the arrays of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.procedural.mesh_shapes import Shape


@dataclass(frozen=True)
class Material:
    """Define the unlit appearance of a surface: texture times tint."""

    texture: int = -1  # index into the textures of the scene, -1 = none
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # sRGB factor
    repeats: float = 1.0  # texture repeats per metre of surface; 1 for images stretched over 0..1
    glow: float = 0.0  # > 0: emissive; display value of its tint, unaffected by baked light
    turned: bool = False  # swaps u and v: grain and planks run across


@dataclass(frozen=True)
class BuiltMesh:
    """Hold the mesh of a generated scene in world coordinates, before its light is baked."""

    vertices: np.ndarray  # [V, 3] float32 metres
    normals: np.ndarray  # [V, 3] float32 unit, towards free space
    faces: np.ndarray  # [F, 3] int32
    uv: np.ndarray  # [V, 2] float32
    tint: np.ndarray  # [V, 3] float32 sRGB factor
    glow: np.ndarray  # [V] float32, 0 = light is baked
    face_texture: np.ndarray  # [F] int32
    face_part: np.ndarray  # [F] int32
    part_names: tuple[str, ...]
    part_structural: np.ndarray  # [P] bool


class MeshBuilder:
    """Build a mesh by adding shapes; each belongs to the part started last and is moved by the current placement."""

    def __init__(self) -> None:
        self._shapes: list[Shape] = []
        self._materials: list[Material] = []
        self._parts: list[int] = []
        self._names: list[str] = []
        self._structural: list[bool] = []
        self._rotation = np.eye(2)
        self._offset = np.zeros(3)

    def part(self, name: str, *, structural: bool = False) -> None:
        """Start a new part; the shapes added next belong to it."""
        self._names.append(name)
        self._structural.append(structural)

    @contextmanager
    def placed(self, offset: tuple[float, float, float], yaw: float = 0.0) -> Iterator[None]:
        """Rotate added shapes by ``yaw`` radians around z and move them by ``offset`` metres; placements nest."""
        before = self._rotation, self._offset
        # Quarter turns are rounded to exact values, so that furniture stays exactly parallel to its wall.
        cos, sin = np.round(np.cos(yaw), 12), np.round(np.sin(yaw), 12)
        moved = np.array(offset, dtype=float)
        moved[:2] = self._rotation @ moved[:2]
        self._offset = self._offset + moved
        self._rotation = self._rotation @ np.array([[cos, -sin], [sin, cos]])
        try:
            yield
        finally:
            self._rotation, self._offset = before

    def add(self, shape: Shape, material: Material) -> None:
        """Add a shape with a material to the current part."""
        if not self._names:
            raise ValueError("start a part before adding shapes to it")
        vertices, normals = shape.vertices.copy(), shape.normals.copy()
        vertices[:, :2] = vertices[:, :2] @ self._rotation.T
        normals[:, :2] = normals[:, :2] @ self._rotation.T
        uv = shape.uv[:, ::-1] if material.turned else shape.uv
        self._shapes.append(Shape(vertices + self._offset, normals, shape.faces, uv * material.repeats))
        self._materials.append(material)
        self._parts.append(len(self._names) - 1)

    def build(self) -> BuiltMesh:
        """Return the mesh of all added shapes; parts without shapes keep their number."""
        shapes, materials = self._shapes, self._materials
        vertex_count = [len(shape.vertices) for shape in shapes]
        face_count = [len(shape.faces) for shape in shapes]
        offsets = np.repeat(np.cumsum([0, *vertex_count[:-1]]), face_count)[:, None]
        return BuiltMesh(
            vertices=np.concatenate([shape.vertices for shape in shapes]).astype(np.float32),
            normals=np.concatenate([shape.normals for shape in shapes]).astype(np.float32),
            faces=(np.concatenate([shape.faces for shape in shapes]) + offsets).astype(np.int32),
            uv=np.concatenate([shape.uv for shape in shapes]).astype(np.float32),
            tint=np.repeat(np.array([m.tint for m in materials], dtype=np.float32), vertex_count, axis=0),
            glow=np.repeat(np.array([m.glow for m in materials], dtype=np.float32), vertex_count),
            face_texture=np.repeat(np.array([m.texture for m in materials], dtype=np.int32), face_count),
            face_part=np.repeat(np.array(self._parts, dtype=np.int32), face_count),
            part_names=tuple(self._names),
            part_structural=np.array(self._structural, dtype=bool),
        )
