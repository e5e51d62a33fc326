"""Load Matterport3D scenes in the folder layout of the Habitat download: ``mp3d/<id>/<id>.glb``, metres, z up.

The files ``<id>.house``, ``<id>.navmesh`` and ``<id>_semantic.ply`` next to the mesh are not needed, but they identify
a scene of this dataset. Source of the layout: [matterport3d], its data_organization.md.
"""

from __future__ import annotations

import os
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.datasets import MATTERPORT3D, find_scene
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.scene import Scene

# Endings of files that only this dataset has. Other scenes have navmeshes too, and any file may be house/house.glb.
_OWN_FILES = (".house", "_semantic.ply")


def load_matterport3d_scene(path: str | os.PathLike[str], *, max_texture: int = 512) -> Scene:
    """Load a Matterport3D scene from its folder ``mp3d/<id>``, its mesh ``<id>.glb``, or a name in the papers' tables.

    Raises `InputError` if the mesh is missing or cannot be read.
    """
    path = find_scene(MATTERPORT3D, path)
    if path.name in ("", ".."):  # "." has a name too
        path = Path(os.path.abspath(path))
    if path.is_dir():
        mesh_file = path / f"{path.name}.glb"
        if not mesh_file.is_file():
            found = sorted(p for p in path.glob("*.glb") if not p.name.endswith("_semantic.glb"))
            if len(found) != 1:
                raise InputError(
                    f"'{path}' is not a Matterport3D scene: expected '{path.name}.glb' in it, found "
                    f"{', '.join(p.name for p in found) or 'no .glb file'}"
                )
            mesh_file = found[0]
    else:
        mesh_file = path
        if path.is_file() and path.suffix.lower() != ".glb":
            raise InputError(f"'{path}' is not a Matterport3D mesh, which is <id>/<id>.glb; load it as mesh:{path}")
    return load_mesh_scene(mesh_file, units="m", up="z", max_texture=max_texture)


def is_matterport3d(path: Path) -> bool:
    """Return whether the path is a Matterport3D scene; it identifies paths without a loader prefix.

    The files ``.house`` or ``_semantic.ply`` next to the mesh identify the dataset.
    """
    path = Path(os.path.abspath(path))
    mesh_file = path / f"{path.name}.glb" if path.is_dir() else path
    if mesh_file.suffix.lower() != ".glb" or not mesh_file.is_file():
        return False
    return any(mesh_file.with_name(mesh_file.stem + suffix).is_file() for suffix in _OWN_FILES)
