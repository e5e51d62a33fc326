"""Load any mesh as a `Scene`: the common loader for glb, gltf, obj, ply, stl and dae.

File units and axes are converted to metres and z up. Every fault of a mesh is reported in one sentence, and a scale
check reports whether the units are plausible.
"""

from __future__ import annotations

import os
import unicodedata
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.errors import InputError, InputWarning, short_repr, unknown_name
from activestructure_gym.scenes.loaders.damage import in_words
from activestructure_gym.scenes.loaders.references import PICTURE_FOLDERS
from activestructure_gym.scenes.loaders.units import metres_per_unit, scale_note, units_hint
from activestructure_gym.scenes.loaders.upright import UP_AXES, DeclaredUp, choose_up
from activestructure_gym.scenes.scene import PartLabels, Scene, SceneMesh

if TYPE_CHECKING:
    from activestructure_gym.scenes.loaders.mesh_parts import MeshPart, TextureStore

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".dae")


# For each up axis: the axes of the file that become world x, y and z, and their signs. All are rotations, not
# mirrorings.
_WORLD_FROM_FILE = {
    "z": ((0, 1, 2), (1, 1, 1)),
    "-z": ((0, 1, 2), (1, -1, -1)),
    "y": ((0, 2, 1), (1, -1, 1)),
    "-y": ((0, 2, 1), (1, 1, -1)),
    "x": ((2, 1, 0), (-1, 1, 1)),
    "-x": ((2, 1, 0), (1, 1, -1)),
}

_MAX_OVERLAP = 300  # maximum mean number of triangle boxes that a line through the scene meets; scans have 4 to 20
_PLAUSIBLE_EXTENT = (0.5, 200.0)  # metres, longest side of a room or building
_COARSEST_STEP = 0.001  # metres between neighbouring float32 positions; larger steps distort walls and depth
_FACES_AT_ONCE = 1 << 18  # number of faces whose corners are converted to float64 at a time: 50 MB instead of gigabytes


def load_mesh_scene(
    path: str | os.PathLike[str],
    *,
    units: str | float | None = None,
    up: str | None = None,
    name: str | None = None,
    max_texture: int = 512,
) -> Scene:
    """Read a mesh file and return it as a scene.

    Parameters
    ----------
    path
        A .glb, .gltf, .obj, .ply, .stl or .dae file.
    units
        "m", "dm", "cm", "mm", "in", "ft", or metres per file unit. None: as declared by the file (COLLADA only), else
        metres.
    up
        The file's up axis: "x", "y", "z", "-x", "-y" or "-z"; "auto": estimated from the geometry. None: as declared by
        the file (COLLADA; glTF under "up" in the extras of its asset or scene), else y for glTF (its standard) and z
        for others. An axis from the format alone is refused if the geometry clearly contradicts it.
    name
        Name of the scene; by default the file's name.
    max_texture
        Pixels; larger textures are shrunk.

    Raises
    ------
    InputError
        If the file is missing, unsupported, damaged, empty, not finite, of implausible size, or not upright. Doubts are
        reported as `InputWarning` and in the scene's notes.
    """
    from activestructure_gym.scenes.loaders.mesh_parts import TextureStore, assemble

    path = check_mesh_file(path)
    if max_texture < 1:
        raise InputError(f"max_texture is the largest side of a texture in pixels, at least 1, got {max_texture}")
    textures = TextureStore(max_texture)
    if up not in (None, "auto", *UP_AXES):
        raise unknown_name("up axis", str(up), ("auto", *UP_AXES))
    parts, declared_scale, declared_up = _read(path, textures)
    scale = declared_scale if units is None else metres_per_unit(units)
    _check_parts(path, parts)
    told = len(textures.notes)
    solid = solid_parts(parts, textures, scale)
    if not solid and path.suffix.lower() not in (".glb", ".gltf"):
        # Some exporters of these formats write inverted alpha, or a meaningless alpha of 0.
        textures.notes[told:] = ["every face is transparent in the file, so all of them are read as solid"]
        solid = [replace(part, opacity=None) for part in parts]
    check_visible(path, solid)
    mesh = assemble(solid, textures.images)
    mesh, unpainted = painted(mesh)
    vertices = mesh.vertices.astype(np.float64) * scale
    try:
        up, doubts = choose_up(path, vertices, mesh.faces, given=up, declared=declared_up)
    except InputError:
        _check_extent(path, vertices, scale)  # a wrong unit is the more likely reason
        raise
    mesh = replace(mesh, vertices=upright(vertices, up).astype(np.float32))
    doubts = [*texture_notes(textures), *doubts, *unpainted]
    return finished_scene(mesh, path, name=name or path.stem, doubts=doubts, scale=scale)


def read_parts(path: Path, textures: TextureStore) -> list[MeshPart]:
    """Return the parts of a mesh file in its own axes and in metres, including transparent ones (see `solid_parts`).

    Raises `InputError` if it cannot be read.
    """
    parts, scale, _ = _read(check_mesh_file(path), textures)
    _check_parts(path, parts)
    return [replace(part, vertices=np.asarray(part.vertices, dtype=np.float64) * scale) for part in parts]


def solid_parts(parts: Sequence[MeshPart], textures: TextureStore, scale: float = 1.0) -> list[MeshPart]:
    """Return the parts without transparent surfaces, and add a note on the removed ones to ``textures``.

    ``scale`` is metres per unit of the parts.
    """
    from activestructure_gym.scenes.loaders.cut_out import cut_out

    solid, found = cut_out(parts, scale)
    textures.notes += found.notes()
    return solid


def check_visible(path: Path, parts: Sequence[MeshPart]) -> None:
    """Raise `InputError` if a file is entirely transparent, which means that it has no solid ``parts``."""
    if not parts:
        raise InputError(
            f"'{path}' is transparent everywhere: each of its triangles has an opacity below 0.5 (or the cutoff of its "
            "material), so nothing of it can be seen; export it with opaque materials"
        )


def upright(vertices: np.ndarray, up: str) -> np.ndarray:  # [V, 3] -> [V, 3]
    """Return the vertices with their axes permuted so that ``up`` becomes z.

    Numbers are copied exactly, so files that differ only in their axes give equal scenes.
    """
    axes, signs = _WORLD_FROM_FILE[up]
    return vertices[:, axes] * signs + 0.0  # no -0.0: its bytes differ from 0.0, and the content hash reads bytes


def check_mesh_file(path: str | os.PathLike[str]) -> Path:
    """Return the path if it is a file with a supported suffix; raise `InputError` otherwise."""
    path = Path(os.path.expanduser(path))
    check_printable(str(path))
    if path.is_dir():
        raise InputError(f"'{path}' is a folder; give the mesh file in it ({', '.join(MESH_SUFFIXES)})")
    if not path.is_file():
        raise InputError(f"there is no mesh file '{path}'")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"'{path}' is not a mesh file this loader knows; it reads {', '.join(MESH_SUFFIXES)}")
    return path


def check_printable(name: str) -> None:
    """Raise `InputError` for a name with line ends or unprintable characters."""
    if any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in name):
        raise InputError(
            f"the name {short_repr(name)} has characters that cannot be printed; rename the file or the scene"
        )


def finished_scene(
    mesh: SceneMesh,  # world axes, metres
    path: Path,
    *,
    name: str,
    doubts: Sequence[str] = (),
    scale: float = 1.0,  # metres per file unit, already applied; messages need it to suggest other units
    labels: PartLabels | None = None,
) -> Scene:
    """Return the scene of a mesh without faces of zero area, after checks of its size and scale.

    ``doubts`` about orientation and textures, and doubts about the scale, are stored in the scene's notes and reported
    as one `InputWarning`. Raises `InputError` for an unusable mesh.
    """
    keep = _has_area(mesh)
    dropped = int((~keep).sum())
    if dropped:
        mesh = replace(mesh, faces=mesh.faces[keep], face_texture=mesh.face_texture[keep])
        labels = replace(labels, face_part=labels.face_part[keep]) if labels is not None else None
    check_printable(name)
    if not len(mesh.faces):
        raise InputError(f"'{path}' holds no triangles with an area; give a mesh with a surface, not points or lines")
    mesh = _without_loose_vertices(mesh)
    _check_extent(path, mesh.vertices, scale)
    _check_overlap(path, mesh)
    scene = Scene(name=name, mesh=mesh, source=str(path), labels=labels)
    doubts, notes = list(doubts), []
    if dropped:
        notes.append(f"{dropped} triangles without area were dropped")
    farthest = np.abs(mesh.vertices).max()
    if np.spacing(farthest) > _COARSEST_STEP:
        doubts.append(
            f"the mesh is {farthest:.0f} m from the origin, where positions are kept in steps of "
            f"{1000 * np.spacing(farthest):.0f} mm: move it to the origin"
        )
    if not mesh.textures and not np.ptp(mesh.colors, axis=0).any():
        notes.append("the mesh has one colour only: images of it are flat, and PSNR and SSIM say little")
    size, plausible = scale_note(scene, scale)
    said = doubts if plausible else [size, *doubts]
    if said:
        warnings.warn(f"{path.name}: {'; '.join(said)}", InputWarning, stacklevel=3)
    return replace(scene, notes=(size, *doubts, *notes))


def texture_notes(textures: TextureStore) -> list[str]:
    """Return the notes of the readers, and messages on missing or unreadable textures."""
    notes = list(dict.fromkeys(textures.notes))
    missing, bare, ignored = (
        list(dict.fromkeys(names)) for names in (textures.unreadable, textures.without_uv, textures.ignored)
    )
    if missing:
        searched = ""
        if textures.searched is not None:
            searched = f", searched in '{textures.searched}', {', '.join(PICTURE_FOLDERS)}"
        notes.append(
            f"{len(missing)} texture or material files could not be read ({_some(missing)}){searched}; plain colours "
            "replace them"
        )
    if bare:
        notes.append(
            f"{len(bare)} materials have a texture, but surfaces without usable texture coordinates "
            f"({_some(bare)}); plain colours replace them"
        )
    if ignored:
        notes.append(f"texture settings that are not supported were ignored ({_some(ignored)})")
    return notes


def _some(names: list[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")


def _read(path: Path, textures: TextureStore) -> tuple[list[MeshPart], float, DeclaredUp]:
    """Return the parts of a file in its own units, metres per unit, and the up axis declared by the file or its format.

    Raises `InputError` for an unreadable file.
    """
    suffix = path.suffix.lower()
    try:
        if suffix in (".glb", ".gltf"):
            from activestructure_gym.scenes.loaders.gltf import read_gltf

            gltf = read_gltf(path, textures)
            if gltf.up is not None:
                return gltf.parts, 1.0, DeclaredUp(gltf.up, "by its extras", explicit=True)
            return gltf.parts, 1.0, DeclaredUp("y", "in glTF")
        if suffix == ".dae":
            from activestructure_gym.scenes.loaders.collada import read_collada

            collada = read_collada(path, textures)
            return collada.parts, collada.metres_per_unit, DeclaredUp(collada.up, "by its up_axis")
        declared = DeclaredUp("z", f"for {suffix[1:].upper()} files, which do not say")
        if suffix == ".stl":
            from activestructure_gym.scenes.loaders.stl import read_stl

            return read_stl(textures.budget.read(path), textures), 1.0, declared
        from activestructure_gym.scenes.loaders.trimesh_reader import read_with_trimesh

        return read_with_trimesh(path, textures), 1.0, declared
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(f"'{path}' does not fit into the memory of this machine; decimate the mesh") from error
    except Exception as error:  # damaged files cause errors of any type, from KeyError to struct.error
        raise InputError(f"'{path}' cannot be read as {suffix[1:].upper()}: {in_words(error)}") from error


def _check_parts(path: Path, parts: Sequence[MeshPart]) -> None:
    if not sum(len(part.faces) for part in parts):
        raise InputError(f"'{path}' holds no triangles; give a mesh with a surface, not points or lines")
    broken = 0
    for part in parts:
        faces = np.asarray(part.faces)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(part.vertices)):
            raise InputError(f"'{path}' is corrupt: its triangles name vertices that do not exist; export it again")
        for what, values in (("colours", part.colors), ("texture coordinates", part.uv)):
            if values is not None and np.ndim(values) == 2 and len(values) != len(part.vertices):
                raise InputError(
                    f"'{path}' is corrupt: a part of it has {len(part.vertices)} vertices and {len(values)} {what}; "
                    "export it again"
                )
        # Positions are stored as float32; the comparison excludes NaN too.
        broken += int((~(np.abs(part.vertices) < np.finfo(np.float32).max).all(axis=1)).sum())
    if broken:
        total = sum(len(part.vertices) for part in parts)
        raise InputError(
            f"'{path}' has {broken} of {total} vertices that are not finite (NaN or infinite); repair the mesh first"
        )


def painted(mesh: SceneMesh) -> tuple[SceneMesh, list[str]]:
    """Return the mesh with vertices of non-finite colour or uv in plain grey, and a message on them (or none)."""
    from activestructure_gym.scenes.loaders.mesh_parts import PLAIN_GREY

    broken = ~(np.isfinite(mesh.colors).all(axis=1) & np.isfinite(mesh.uv).all(axis=1))
    if not broken.any():
        return mesh, []
    colors = np.where(broken[:, None], np.float32(PLAIN_GREY), mesh.colors)
    mesh = replace(mesh, colors=colors, uv=np.where(broken[:, None], np.float32(0), mesh.uv))
    said = f"{int(broken.sum())} vertices have colours or texture coordinates that are not finite: painted grey"
    return mesh, [said]


def _without_loose_vertices(mesh: SceneMesh) -> SceneMesh:
    """Return the mesh without vertices that no triangle uses; distant ones would enlarge the bounds."""
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[mesh.faces] = True
    if used.all():
        return mesh
    index = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return replace(
        mesh, vertices=mesh.vertices[used], colors=mesh.colors[used], uv=mesh.uv[used], faces=index[mesh.faces]
    )


def _has_area(mesh: SceneMesh) -> np.ndarray:  # [F] bool
    has = np.empty(len(mesh.faces), dtype=bool)
    for start in range(0, len(has), _FACES_AT_ONCE):
        block = slice(start, start + _FACES_AT_ONCE)
        corners = mesh.vertices[mesh.faces[block]].astype(np.float64)  # [f, 3, 3]
        doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        has[block] = doubled > 1e-12  # square metres: a needle of 1 mm x 1 nm
    return has


def _check_extent(path: Path, vertices: np.ndarray, scale: float) -> None:
    extent = vertices.max(axis=0).astype(np.float64) - vertices.min(axis=0)
    longest = float(extent.max())
    if _PLAUSIBLE_EXTENT[0] <= longest <= _PLAUSIBLE_EXTENT[1]:
        return
    # A room or apartment is 2 to 60 m long; units that give such a length are suggested.
    hint = units_hint(extent / scale, longest / scale, 2.0, 60.0)
    size = " x ".join(f"{side:.4g}" for side in extent)
    raise InputError(f"'{path}' is {size} m (x, y, z), which is no room or building: {hint}")


def _check_overlap(path: Path, mesh: SceneMesh) -> None:
    """Raise `InputError` if too many triangles overlap, since a ray would have to test all of them."""
    total = 0.0
    for start in range(0, len(mesh.faces), _FACES_AT_ONCE):
        corners = mesh.vertices[mesh.faces[start : start + _FACES_AT_ONCE]].astype(np.float64)
        total += _box_area(np.ptp(corners, axis=1)).sum()
    # Mean number of triangle boxes that a random line through the scene hits (Cauchy's formula).
    times = total / _box_area(np.ptp(mesh.vertices, axis=0).astype(np.float64))
    if times > _MAX_OVERLAP:
        raise InputError(
            f"'{path}' has overlapping triangles: a line through it meets about {times:,.0f} triangle boxes (a "
            f"furnished apartment: 20, limit: {_MAX_OVERLAP}); remove the copies"
        )


def _box_area(sides: np.ndarray) -> np.ndarray:  # [..., 3] -> [...], half the surface
    x, y, z = sides[..., 0], sides[..., 1], sides[..., 2]
    return x * y + y * z + x * z
