"""The scenes of published datasets that papers of this field report on, by name.

``replica:office_2`` is the folder of that scene, wherever it lies: a path that is there is taken as it is, a name is
looked for in the folder that the dataset's environment variable names. Which scenes: Tables 1 and 2 of
[activestructure], whose column titles (``Off2``, ``R0``, ``gZ6f``) are names too.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.scene import Scene


@dataclass(frozen=True)
class Dataset:
    """A published dataset of scenes."""

    kind: str  # of its reader, as in ``replica:...``
    title: str
    variable: str  # environment variable with the folder that holds the scenes
    source: str  # where one gets it, and under what condition
    scenes: Mapping[str, str]  # folder of each scene, by its title in the papers' tables
    # x, y, z metres and yaw degrees by folder, in the dataset's axes; of scenes without one the first pose of the
    # recorded sequence is where papers start.
    starts: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    endings: tuple[str, ...] = ()  # of a mesh that lies beside a scene's folder, behind the folder's name

    def folder_of(self, name: str) -> str | None:
        """The folder that a scene's name means: its own, its title in tables, or ``office2`` for ``office_2``."""
        asked = _plain(name)
        for title, folder in self.scenes.items():
            if asked in (_plain(title), _plain(folder)):
                return folder
        return None

    def places(self, root: Path, folder: str) -> list[Path]:
        """Where a scene may lie below the dataset's folder, in the layouts that are common."""
        names = dict.fromkeys((folder, folder.replace("_", "")))
        return [root / inner / name for inner in ("", "mp3d", "scans", "replica_v1", "Replica") for name in names]

    def meshes_beside(self, place: Path) -> list[Path]:
        """The meshes of a scene that are there and not in its folder."""
        meshes = [place.parent / f"{place.name}{ending}" for ending in self.endings]
        return [mesh for mesh in meshes if mesh.is_file()]

    def place_in(self, root: Path, folder: str) -> Path | None:
        """The folder of a scene below the dataset's, or where it would be if only its mesh lies there."""
        places = self.places(root, folder)
        return next((p for p in places if p.exists()), None) or next((p for p in places if self.meshes_beside(p)), None)


REPLICA = Dataset(
    kind="replica",
    title="Replica",
    variable="ASG_REPLICA",
    source="https://github.com/facebookresearch/Replica-Dataset, for non-commercial research",
    scenes={
        "Off0": "office_0",
        "Off1": "office_1",
        "Off2": "office_2",
        "Off3": "office_3",
        "Off4": "office_4",
        "R0": "room_0",
        "R1": "room_1",
        "R2": "room_2",
    },
    endings=("_mesh.ply", ".ply"),  # NICE-SLAM's download puts the mesh beside the sequence
)
MATTERPORT3D = Dataset(
    kind="matterport3d",
    title="Matterport3D",
    variable="ASG_MATTERPORT3D",
    source="https://niessner.github.io/Matterport/, after signing its terms of use",
    scenes={
        "Gdv": "GdvgFV5R1Z5",
        "gZ6f": "gZ6f7yhEvPG",
        "HxpK": "HxpKQynjfin",
        "pLe4": "pLe4wQe7qrG",
        "YmJk": "YmJkqBEsHnH",
    },
    # `start_c2w` of configs/MP3D/*/ActiveGAMER.py in [activegamer, code]: level, along +y, the last one along -x.
    starts={
        "GdvgFV5R1Z5": (-4.0, 1.0, 1.5, 90.0),
        "gZ6f7yhEvPG": (0.0, 0.0, 2.0, 90.0),
        "HxpKQynjfin": (2.0, -3.5, 1.5, 90.0),
        "pLe4wQe7qrG": (5.0, 0.0, 1.75, 90.0),
        "YmJkqBEsHnH": (0.0, -2.0, 1.75, 180.0),
    },
)
DATASETS = {dataset.kind: dataset for dataset in (REPLICA, MATTERPORT3D)}


def find_scene(dataset: Dataset, path: str | os.PathLike[str]) -> Path:
    """The place of a scene: ``path`` itself if something is there or it names none of the dataset's scenes.

    Raises `InputError` for a name whose scene is not found.
    """
    given = Path(os.path.expanduser(path))
    folder = dataset.folder_of(str(path))
    if folder is None or given.exists():
        return given
    root = os.environ.get(dataset.variable, "").strip()
    if not root:
        raise InputError(
            f"the {dataset.title} scene '{path}' is looked for in the folder that the environment variable "
            f"{dataset.variable} names, which is not set; get the dataset from {dataset.source}"
        )
    place = dataset.place_in(Path(os.path.expanduser(root)), folder)
    if place is not None:
        return place
    raise InputError(
        f"{dataset.variable} is '{root}', but there is no scene '{folder}' in it; "
        f"`asg doctor --dataset {dataset.kind} {root}` says what is there"
    )


def published_start(scene: Scene) -> tuple[float, float, float, float]:  # x, y, z metres, yaw degrees
    """Where [activegamer, code] starts in a scene: its configured pose in Matterport3D, and in Replica the first pose
    of the recorded sequence, of which place and heading are taken (every pose here begins level).

    Raises `InputError` for a scene without one.
    """
    for dataset in DATASETS.values():
        folder = dataset.folder_of(scene.name)
        if folder is None:
            continue
        if folder in dataset.starts:
            return dataset.starts[folder]
        if scene.evaluation_views is not None:
            first = scene.evaluation_views.world_from_camera[0]
            x, y, z = first[:3, 3].tolist()
            return x, y, z, float(np.degrees(np.arctan2(first[1, 2], first[0, 2])))
    raise InputError(
        f"no start is published for the scene '{scene.name}'; of Replica it is the first pose of a recorded sequence "
        "(`?sequence=FOLDER`), else give --start x,y,z,yaw"
    )


def _plain(name: str) -> str:
    return name.replace("_", "").lower()
