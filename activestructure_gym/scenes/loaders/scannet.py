"""Load scans of ScanNet and ScanNet++ in their published folder layouts; metres, z up.

ScanNet: ``<scan>/<scan>_vh_clean_2.ply`` and ``<scan>/<scan>.txt``. Its line ``axisAlignment`` holds, row by row, the
16 numbers of the transform that aligns the walls with the axes; without it the scan is not transformed. ScanNet++:
``<scene>/scans/mesh_aligned_0.05.ply``, already aligned. Recorded frames (``.sens``, DSLR, iPhone) and labels are
ignored. Source of the layouts: [scannet], README of its code; [scannetpp], its toolkit.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.budget import SceneBudget
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.scene import Scene

_SCANNET_MESH = "_vh_clean_2.ply"
_SCANNETPP_MESH = Path("scans") / "mesh_aligned_0.05.ply"
_RIGID = 1e-3  # largest accepted entry of R R^T - I; the files have six decimals
_MAX_TRANSLATION_M = 1e4  # metres, largest accepted translation of an alignment


def load_scannet_scene(path: str | os.PathLike[str]) -> Scene:
    """Load a ScanNet scan from its folder ``scans/scene0000_00`` or its mesh ``scene0000_00_vh_clean_2.ply``.

    Raises `InputError` if the mesh or its text file is missing or cannot be read.
    """
    path = Path(os.path.abspath(os.path.expanduser(path)))
    mesh_file = path / f"{path.name}{_SCANNET_MESH}" if path.is_dir() else path
    if not mesh_file.name.endswith(_SCANNET_MESH) or not mesh_file.is_file():
        raise InputError(
            f"'{path}' is not a ScanNet scan: expected a folder <scan> with '<scan>{_SCANNET_MESH}' in it, found no "
            f"file '{mesh_file.name}'; download the scan's _vh_clean_2.ply and .txt"
        )
    name = mesh_file.name.removesuffix(_SCANNET_MESH)
    motion = axis_alignment(mesh_file.with_name(f"{name}.txt"))
    scene = load_mesh_scene(mesh_file, units="m", up="z", name=name)
    vertices = scene.mesh.vertices.astype(np.float64) @ motion[:3, :3].T + motion[:3, 3]
    return replace(scene, mesh=replace(scene.mesh, vertices=(vertices + 0.0).astype(np.float32)))


def load_scannetpp_scene(path: str | os.PathLike[str]) -> Scene:
    """Load a ScanNet++ scene from its folder ``data/<scene>`` or its mesh ``scans/mesh_aligned_0.05.ply``.

    Raises `InputError` if the mesh is missing or cannot be read.
    """
    path = Path(os.path.abspath(os.path.expanduser(path)))
    mesh_file = path / _SCANNETPP_MESH if path.is_dir() else path
    if mesh_file.name != _SCANNETPP_MESH.name or not mesh_file.is_file():
        raise InputError(
            f"'{path}' is not a ScanNet++ scene: expected a folder <scene> with '{_SCANNETPP_MESH}' in it, found no "
            "such file; download the scene's mesh, or load another one as mesh:FILE"
        )
    return load_mesh_scene(mesh_file, units="m", up="z", name=mesh_file.parent.parent.name)


def is_scannet(path: Path) -> bool:
    """Return whether the path is a ScanNet scan with its text file; it identifies paths without a loader prefix."""
    path = Path(os.path.abspath(path))
    mesh_file = path / f"{path.name}{_SCANNET_MESH}" if path.is_dir() else path
    name = mesh_file.name.removesuffix(_SCANNET_MESH)
    return name != mesh_file.name and mesh_file.is_file() and mesh_file.with_name(f"{name}.txt").is_file()


def is_scannetpp(path: Path) -> bool:
    """Return whether the path is a ScanNet++ scene; it identifies paths without a loader prefix."""
    if path.is_dir():
        return (path / _SCANNETPP_MESH).is_file()
    return path.name == _SCANNETPP_MESH.name and path.is_file()


def axis_alignment(path: Path) -> np.ndarray:  # [4, 4]
    """Return the transform ``axisAlignment`` in a scan's text file, or the identity if the file has none.

    Raises `InputError` if the file is missing or invalid.
    """
    if not path.is_file():
        raise InputError(
            f"there is no '{path}', the text file of a ScanNet scan with its axisAlignment; download it, or load the "
            "mesh as it is with mesh:FILE"
        )
    try:
        text = SceneBudget().read(path).decode()
    except (ValueError, OSError) as error:
        raise InputError(f"'{path}' is not the text file of a ScanNet scan: {' '.join(str(error).split())}") from error
    for line in text.splitlines():
        key, equals, said = line.partition("=")
        if equals and key.strip() == "axisAlignment":
            return _rigid(path, said)
    return np.eye(4)


def _rigid(path: Path, said: str) -> np.ndarray:  # [4, 4]
    try:
        numbers = np.array([float(word) for word in said.split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) == 16 and np.isfinite(numbers).all():
        motion = numbers.reshape(4, 4)
        turn = motion[:3, :3]
        if (
            np.abs(turn @ turn.T - np.eye(3)).max() < _RIGID
            and np.linalg.det(turn) > 0
            and np.abs(motion[:3, 3]).max() < _MAX_TRANSLATION_M
            and np.abs(motion[3] - (0, 0, 0, 1)).max() < _RIGID
        ):
            return motion
    raise InputError(
        f"'{path}': axisAlignment must be 16 numbers, a rotation and a shift row by row, got "
        f"'{' '.join(said.split())[:80]}'; download the file again"
    )
