"""Load scans of HM3D and Gibson in the folder layouts of their downloads; metres, z up.

HM3D: ``<split>/00800-TEEsavR23oF/TEEsavR23oF.glb``. The copy for Habitat, ``TEEsavR23oF.basis.glb``, has Basis
textures, which are not supported. Gibson, as converted for Habitat: ``Adrian.glb`` with ``Adrian.navmesh``. Both have
gravity along -z, unlike glTF. Source of the layouts: [hm3d], [gibson], the dataset page of [habitat].
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.scene import Scene

_BASIS = ".basis.glb"
_FOLDER = re.compile(r"\d{5}-(\w+)")


def load_hm3d_scene(path: str | os.PathLike[str], *, max_texture: int = 512) -> Scene:
    """Load an HM3D scan from its folder ``val/00800-TEEsavR23oF`` or its mesh ``TEEsavR23oF.glb``.

    Raises `InputError` if the mesh is missing or cannot be read.
    """
    path = Path(os.path.abspath(os.path.expanduser(path)))
    mesh_file = _mesh_in(path) if path.is_dir() else path
    if mesh_file.name.endswith(_BASIS):  # the scan's own mesh is in the same folder
        mesh_file = mesh_file.with_name(f"{mesh_file.name.removesuffix(_BASIS)}.glb")
    if not mesh_file.is_file():
        beside = mesh_file.with_name(f"{mesh_file.stem}{_BASIS}")
        hint = ", only its copy for Habitat, whose textures are Basis" if beside.is_file() else ""
        raise InputError(
            f"'{path}' is not an HM3D scan that can be read: there is no file '{mesh_file.name}'"
            f"{hint}; download the split's `glb` archive"
        )
    if mesh_file.suffix.lower() != ".glb":
        raise InputError(f"'{path}' is not an HM3D mesh, which is <scan>/<id>.glb; load it as mesh:{path}")
    return load_mesh_scene(mesh_file, units="m", up="z", max_texture=max_texture)


def is_hm3d(path: Path) -> bool:
    """Return whether the path is an HM3D folder, by its name and a mesh of that name, or such a mesh.

    It identifies paths given without a loader prefix.
    """
    path = Path(os.path.abspath(path))
    folder = path if path.is_dir() else path.parent
    named = _FOLDER.fullmatch(folder.name)
    if named is None:
        return False
    meshes = [folder / f"{named[1]}{ending}" for ending in (".glb", _BASIS)]
    return any(mesh.is_file() and path in (folder, mesh) for mesh in meshes)


def _mesh_in(folder: Path) -> Path:
    named = _FOLDER.fullmatch(folder.name)
    if named:
        return folder / f"{named[1]}.glb"
    meshes = [file for file in sorted(folder.glob("*.glb")) if "." not in file.stem]
    if len(meshes) != 1:
        raise InputError(
            f"'{folder}' is not a folder of an HM3D scan: expected a name like 00800-TEEsavR23oF, or one .glb file in "
            f"it, found {len(meshes)}"
        )
    return meshes[0]


def load_gibson_scene(path: str | os.PathLike[str], *, max_texture: int = 512) -> Scene:
    """Load a Gibson scan as converted for Habitat: ``gibson/Adrian.glb``, or ``gibson/Adrian`` without the ending.

    Raises `InputError` if the mesh is missing or cannot be read.
    """
    given = Path(os.path.expanduser(path))
    mesh_file = given
    if given.suffix.lower() != ".glb":
        mesh_file = given / f"{given.name}.glb" if given.is_dir() else given.with_name(f"{given.name}.glb")
    if not mesh_file.is_file():
        raise InputError(
            f"there is no Gibson scan '{given}': expected the file '{mesh_file}' of the download for Habitat "
            "(gibson_habitat.zip); the original meshes load as mesh:FILE?up=z"
        )
    return load_mesh_scene(mesh_file, units="m", up="z", max_texture=max_texture)
