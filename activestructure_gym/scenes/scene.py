"""Define `Scene`: a coloured triangle mesh with a name, a source and a ray caster.

Free space, start poses and observable surface belong to `ground_truth.GroundTruth`.
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


# Wrap modes of a texture outside its image, along one axis.
REPEAT, CLAMP, MIRROR = 0, 1, 2


@dataclass(frozen=True)
class SceneMesh:
    """Hold triangles and their colour: texture (if a face has one) times vertex colour, clipped to [0, 1].

    Vertices are duplicated along texture seams (the layout of glTF), so one uv per vertex suffices. Colours and
    textures are display-referred (sRGB); vertex colours may exceed 1 with baked light. With ``linear_colors``, vertex
    colours are linear light and are converted to display-referred after interpolation (glTF 2.0, 3.9.2).
    """

    vertices: np.ndarray  # [V, 3] float32 metres, world (z up)
    faces: np.ndarray  # [F, 3] int32
    colors: np.ndarray  # [V, 3] float32
    uv: np.ndarray  # [V, 2] float32, v down from the image's top row; 0 if unused
    face_texture: np.ndarray  # [F] int32 index into textures, -1 = none
    textures: tuple[np.ndarray, ...] = ()  # each [h, w, 3] uint8
    texture_wrap: tuple[tuple[int, int], ...] = ()  # wrap mode of each texture across and down; () = all repeat
    linear_colors: bool = False  # whether vertex colours are linear light instead of sRGB

    def wrong(self) -> str:
        """Return a message on the first fault of the arrays, or "" if there is none.

        Call it before ray casting and shading, which do not check indices.
        """
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
    """Hold ground truth for tests only: the part of the scene that each face belongs to."""

    face_part: np.ndarray  # [F] int32
    names: tuple[str, ...]  # one per part
    structural: np.ndarray  # [P] bool: wall, floor, ceiling, jamb; False = object


@dataclass(frozen=True)
class Scene:
    """Hold an immutable mesh with a name and a source; data derived from it are computed once."""

    name: str  # name in messages and results
    mesh: SceneMesh  # metres, z up
    source: str  # origin: a file, or a generator and its arguments
    labels: PartLabels | None = None  # part of each face, for tests; None if unknown
    evaluation_views: PosedSequence | None = None  # recorded views that belong to the scene, for evaluation
    notes: tuple[str, ...] = field(default=())  # messages of the loader to the user (scale check, dropped parts)
    inside: tuple[float, float, float] | None = None  # metres: a point in the free-space region to use
    generated: bool = False  # ``source`` names a generator of this package and all its arguments

    def __getstate__(self) -> dict[str, Any]:
        # The ray caster is rebuilt on first use; the small caches are pickled.
        return {key: value for key, value in self.__dict__.items() if key != "raycaster"}

    @cached_property
    def raycaster(self) -> RayCaster:
        """Return the ray caster of the mesh, which is built on first use."""
        return RayCaster(self.mesh.vertices, self.mesh.faces)

    @cached_property
    def bounds(self) -> np.ndarray:  # [2, 3] float64 metres
        """Return the axis-aligned bounding box of the mesh; every planner gets it as the workspace."""
        return np.stack([self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)]).astype(np.float64)

    @cached_property
    def content_hash(self) -> str:
        """Return the SHA-256 of geometry, appearance and region, in hex: the key of every cache and every result."""
        digest = hashlib.sha256()
        mesh = self.mesh
        for array in (mesh.vertices, mesh.faces, mesh.colors, mesh.uv, mesh.face_texture, *mesh.textures):
            digest.update(str((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        if mesh.texture_wrap or mesh.linear_colors:  # only if not default, so that all other scenes keep their keys
            digest.update(str((mesh.texture_wrap, mesh.linear_colors)).encode())
        if self.inside is not None:  # as above
            digest.update(str(("inside", self.inside)).encode())
        if self.generated:  # a file with the same mesh has another `draw_key`
            digest.update(str(("generated", self.source)).encode())
        return digest.hexdigest()

    @cached_property
    def draw_key(self) -> str:
        """Return the SHA-256, in hex, that seeds starts, held-out views and surface samples of the scene.

        It is `content_hash`. Of a generated scene it is the hash of ``source`` and ``inside``, since the last bits of
        its colours can differ between processors.
        """
        if not self.generated:
            return self.content_hash
        return hashlib.sha256(str((self.source, self.inside)).encode()).hexdigest()
