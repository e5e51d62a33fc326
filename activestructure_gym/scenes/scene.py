"""`Scene`: a coloured triangle mesh with a name and a source, and its ray caster.

What else is true of it (free space, start poses, observable surface) is `ground_truth.GroundTruth`.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.scenes.raycaster import RayCaster

if TYPE_CHECKING:
    from activestructure_gym.scenes.loaders.sequence import PosedSequence


# How a texture goes on outside of its image, along one axis.
REPEAT, CLAMP, MIRROR = 0, 1, 2


@dataclass(frozen=True)
class SceneMesh:
    """Triangles with colour: texture (where a face has one) times vertex colour, clipped to [0, 1].

    Vertices are repeated along texture seams (the layout of glTF), so one uv per vertex is enough. Colours and
    textures are display-referred (sRGB); vertex colours may exceed 1 where baked light does. With ``linear_colors``
    the vertex colours are linear light, and become display-referred after they are interpolated (glTF 2.0, 3.9.2).
    """

    vertices: np.ndarray  # [V, 3] float32 metres, world (z up)
    faces: np.ndarray  # [F, 3] int32
    colors: np.ndarray  # [V, 3] float32
    uv: np.ndarray  # [V, 2] float32, v down from the image's top row; 0 where unused
    face_texture: np.ndarray  # [F] int32 index into textures, -1 = none
    textures: tuple[np.ndarray, ...] = ()  # each [h, w, 3] uint8
    texture_wrap: tuple[tuple[int, int], ...] = ()  # of each texture across and down; () = all of them repeat
    linear_colors: bool = False

    def wrong(self) -> str:
        """What is wrong with the arrays, empty if nothing is; who casts rays or shades checks no bounds."""
        vertices, faces, textures = len(self.vertices), len(self.faces), self.textures
        if np.shape(self.vertices) != (vertices, 3):
            return f"vertices must be [V, 3], got {np.shape(self.vertices)}"
        if not np.isfinite(self.vertices).all():
            broken = int((~np.isfinite(self.vertices).all(axis=1)).sum())
            return f"{broken} of {vertices} vertices are not finite (NaN or infinite)"
        if np.shape(self.faces) != (faces, 3):
            return f"faces must be [F, 3], got {np.shape(self.faces)}"
        if faces and not (0 <= np.min(self.faces) and np.max(self.faces) < vertices):
            return (
                f"faces must point to the {vertices} vertices, got indices {np.min(self.faces)} to {np.max(self.faces)}"
            )
        if len(self.face_texture) != faces:
            return f"face_texture needs one entry for each of {faces} faces, got {len(self.face_texture)}"
        if faces and not (-1 <= np.min(self.face_texture) and np.max(self.face_texture) < len(textures)):
            return (
                f"face_texture must lie in -1 .. {len(textures) - 1}, got {np.min(self.face_texture)} .. "
                f"{np.max(self.face_texture)}"
            )
        if np.shape(self.colors) != (vertices, 3) or np.shape(self.uv) != (vertices, 2):
            shapes = f"{np.shape(self.colors)} and {np.shape(self.uv)}"
            return f"colors and uv need one row per vertex ({vertices}), got {shapes}"
        for texture in textures:
            if texture.ndim != 3 or texture.shape[2] != 3 or texture.dtype != np.uint8 or not texture.size:
                return f"a texture must be [h, w, 3] uint8, got {texture.shape} {texture.dtype}"
        if len(self.texture_wrap) not in (0, len(textures)):
            return f"texture_wrap needs one entry for each of {len(textures)} textures, or none at all"
        return ""


@dataclass(frozen=True)
class PartLabels:
    """Ground truth for tests only: which part of the scene each face belongs to."""

    face_part: np.ndarray  # [F] int32
    names: tuple[str, ...]  # one per part
    structural: np.ndarray  # [P] bool: wall, floor, ceiling, jamb; False = object


@dataclass(frozen=True)
class Scene:
    """An immutable mesh that an agent can be put into; derived data are computed once and cached by content."""

    name: str  # what people call it
    mesh: SceneMesh  # metres, z up
    source: str  # where it comes from: a file, or a generator with its arguments
    labels: PartLabels | None = None  # of generated scenes, for tests
    evaluation_views: PosedSequence | None = None  # recorded views that came with the scene, for evaluation
    notes: tuple[str, ...] = field(default=())  # what the loader wants the user to read (scale check, dropped parts)
    inside: tuple[float, float, float] | None = None  # metres: a point of the region of free space that is used

    def __getstate__(self) -> dict[str, Any]:
        # The ray caster is rebuilt where it is needed; the small caches travel along.
        return {key: value for key, value in self.__dict__.items() if key != "raycaster"}

    @cached_property
    def raycaster(self) -> RayCaster:
        """The mesh as seen by rays."""
        return RayCaster(self.mesh.vertices, self.mesh.faces)

    @cached_property
    def bounds(self) -> np.ndarray:  # [2, 3] float64 metres
        """Axis-aligned box of the mesh. Public: the workspace every planner is told about."""
        return np.stack([self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)]).astype(np.float64)

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 over geometry, appearance and the chosen region: the key of every cache and of every result."""
        digest = hashlib.sha256()
        mesh = self.mesh
        for array in (mesh.vertices, mesh.faces, mesh.colors, mesh.uv, mesh.face_texture, *mesh.textures):
            digest.update(str((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        if mesh.texture_wrap or mesh.linear_colors:  # the exception, so that the keys of all other scenes stay
            digest.update(str((mesh.texture_wrap, mesh.linear_colors)).encode())
        if self.inside is not None:  # likewise
            digest.update(str(("inside", self.inside)).encode())
        return digest.hexdigest()
