"""Check which scenes of a published dataset a folder holds, and what is missing or damaged.

Meshes are checked by their headers and sizes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from activestructure_gym.errors import InputError
from activestructure_gym.ply_header import NUMPY_TYPES, PlyProperty, read_header
from activestructure_gym.scenes.datasets import REPLICA, Dataset

State = Literal["there", "missing", "damaged"]


@dataclass(frozen=True)
class FileState:
    """Hold the state of one file of a scene."""

    name: str  # path of the file relative to the scene's folder
    state: State
    needed: bool  # whether the scene cannot be loaded without the file
    why: str = ""  # what is wrong with the file, or what is unavailable without it


@dataclass(frozen=True)
class SceneState:
    """Hold the state of one scene of the dataset."""

    title: str  # column title of the scene in the papers' tables
    folder: str  # name of the scene's folder in the dataset
    place: Path | None  # path of the scene's folder; None if not found
    files: tuple[FileState, ...] = ()

    @property
    def usable(self) -> bool:
        """Return whether all needed files exist and pass the checks."""
        return self.place is not None and all(file.state == "there" for file in self.files if file.needed)


def check_dataset(dataset: Dataset, root: Path) -> list[SceneState]:
    """Return the state of each scene of ``dataset`` below the folder ``root``.

    Raises `InputError` if ``root`` is not a folder.
    """
    if not root.is_dir():
        raise InputError(f"there is no folder '{root}'; give the one that holds the scenes of {dataset.title}")
    look = {"replica": _replica, "matterport3d": _matterport3d}[dataset.kind]
    found = []
    for title, folder in dataset.scenes.items():
        place = dataset.place_in(root, folder)
        found.append(SceneState(title, folder, place, () if place is None else tuple(look(place))))
    return found


def _replica(place: Path) -> Iterator[FileState]:
    meshes = [place / "mesh.ply", place / "habitat" / "mesh_semantic.ply", *REPLICA.meshes_beside(place)]
    there = [mesh for mesh in meshes if mesh.is_file()]
    if there:
        for mesh in there:
            why = _wrong_with_ply(mesh)
            name = mesh.relative_to(place if mesh.is_relative_to(place) else place.parent)
            yield FileState(str(name), "damaged" if why else "there", mesh == there[0], why)
    else:
        yield FileState("mesh.ply", "missing", True, "nor habitat/mesh_semantic.ply: the surface itself")
    labels = place / "habitat" / "info_semantic.json"
    semantic = place / "habitat" / "mesh_semantic.ply"
    if labels.is_file() and semantic.is_file():
        why = _wrong_with_json(labels)
        yield FileState("habitat/info_semantic.json", "damaged" if why else "there", False, why)
    else:
        yield FileState("habitat/info_semantic.json", "missing", False, "without it and its mesh objects have no names")
    if not (place / "traj.txt").is_file():
        yield FileState("traj.txt", "missing", False, "without a NICE-SLAM sequence there are no recorded views")


def _matterport3d(place: Path) -> Iterator[FileState]:
    mesh = place / f"{place.name}.glb"
    if not mesh.is_file():
        yield FileState(mesh.name, "missing", True, "the surface itself; it comes with the download for Habitat")
        return
    why = _wrong_with_glb(mesh)
    yield FileState(mesh.name, "damaged" if why else "there", True, why)


def _wrong_with_ply(path: Path) -> str:
    """Return the fault of a PLY file that its header and its size show; "" if there is none."""
    try:
        with open(path, "rb") as file:
            header = read_header(file)
            least = file.tell()
    except OSError as error:
        return str(error)
    if header is None or not header.complete:
        return "it does not begin as a .ply file does" if header is None else "its header does not end"
    for element in header.elements:
        sizes = [_least(p) for p in element.properties]
        least += element.count * sum(sizes)
    size = path.stat().st_size
    if header.format == "ascii" or size >= least:
        return ""
    return f"it has {size:,} bytes, its header speaks of at least {least:,}: cut off?"


def _least(one: PlyProperty) -> int:  # bytes
    """Return the minimum size of a property: one number, or a list with its length and, for faces, three corners."""
    if not one.count_kind:
        return _size(one.kind)
    return _size(one.count_kind) + (3 * _size(one.kind) if one.name in ("vertex_indices", "vertex_index") else 0)


def _size(kind: str) -> int:
    return int(NUMPY_TYPES.get(kind, "u1")[-1])


def _wrong_with_glb(path: Path) -> str:
    """Return the fault of a binary glTF file that its header and its size show; "" if there is none."""
    try:
        with open(path, "rb") as file:
            head = file.read(12)
    except OSError as error:
        return str(error)
    if len(head) < 12 or head[:4] != b"glTF":
        return "it does not begin as a .glb file does"
    told, size = int.from_bytes(head[8:12], "little"), path.stat().st_size
    return "" if told <= size else f"it has {size:,} bytes and says {told:,}: cut off?"


def _wrong_with_json(path: Path) -> str:
    """Return why a file is not valid JSON; "" if it is."""
    try:
        json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        return f"it is not JSON: {error}".splitlines()[0]
    return ""
