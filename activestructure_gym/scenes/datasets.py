"""List the scenes of published datasets that papers of this field report on, and find them by name.

An example of a name is ``office_2`` in ``replica:office_2``. An existing path is used as given. A name is searched in
the folder that the dataset's environment variable contains. The scenes are those of Tables 1 and 2 of
[activestructure]; the column titles of the tables (``Off2``, ``R0``, ``gZ6f``) are accepted as names.
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
    """Describe a published dataset of scenes."""

    kind: str  # prefix of its reader, as in ``replica:...``
    title: str
    variable: str  # environment variable that contains the path of the folder with the scenes
    source: str  # where to get it, and under which terms
    scenes: Mapping[str, str]  # folder of each scene, by its column title in the papers' tables
    # Start poses by folder: x, y, z in metres and yaw in degrees, in the dataset's axes. For other scenes papers start
    # at the first pose of the recorded sequence.
    starts: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    endings: tuple[str, ...] = ()  # suffixes, after the folder's name, of mesh files next to a scene's folder

    def folder_of(self, name: str) -> str | None:
        """Return the folder of a scene by folder name, column title, or a form such as ``office2`` for ``office_2``."""
        asked = _plain(name)
        for title, folder in self.scenes.items():
            if asked in (_plain(title), _plain(folder)):
                return folder
        return None

    def places(self, root: Path, folder: str) -> list[Path]:
        """Return the possible places of a scene below the dataset's folder, for common layouts."""
        names = dict.fromkeys((folder, folder.replace("_", "")))
        return [root / inner / name for inner in ("", "mp3d", "scans", "replica_v1", "Replica") for name in names]

    def meshes_beside(self, place: Path) -> list[Path]:
        """Return the existing mesh files of a scene next to its folder ``place``."""
        meshes = [place.parent / f"{place.name}{ending}" for ending in self.endings]
        return [mesh for mesh in meshes if mesh.is_file()]

    def place_in(self, root: Path, folder: str) -> Path | None:
        """Return the path of a scene's folder below the dataset's folder ``root``; None if it is not found.

        If only the scene's mesh exists, return the path that its folder would have.
        """
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
    endings=("_mesh.ply", ".ply"),  # NICE-SLAM's download stores the mesh next to the sequence
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
    # Poses `start_c2w` of configs/MP3D/*/ActiveGAMER.py in [activegamer, code]. They are level; the view direction is
    # +y, and -x in the last scene.
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
    """Return the path of a scene: ``path`` itself if it exists or is no scene name of the dataset.

    A scene name is searched in the folder that the dataset's environment variable contains. Raises `InputError` for a
    scene that is not found.
    """
    given = Path(os.path.expanduser(path))
    folder = dataset.folder_of(str(path))
    if folder is None or given.exists():
        return given
    root = os.environ.get(dataset.variable, "").strip()
    if not root:
        raise InputError(
            f"the environment variable {dataset.variable} is not set: set it to the folder with the {dataset.title} "
            f"scene '{path}'; get the dataset from {dataset.source}"
        )
    place = dataset.place_in(Path(os.path.expanduser(root)), folder)
    if place is not None:
        return place
    raise InputError(
        f"{dataset.variable} is '{root}', but there is no scene '{folder}' in it; "
        f"`asg doctor --dataset {dataset.kind} {root}` lists what it contains"
    )


def published_start(scene: Scene) -> tuple[float, float, float, float]:  # x, y, z metres, yaw degrees
    """Return the start pose of [activegamer, code] in a scene: position in metres and yaw in degrees.

    For Matterport3D, it is the pose in the code's configuration. For Replica, it is position and heading of the first
    pose of the recorded sequence; episodes start level. Raises `InputError` for a scene without a published start pose.
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
        f"no start is published for the scene '{scene.name}': give --start x,y,z,yaw, or for Replica a recorded "
        "sequence (`?sequence=FOLDER`), whose first pose is the start"
    )


def _plain(name: str) -> str:
    return name.replace("_", "").lower()
