"""Links from the page to what lies in the runs' directories: the replay to watch, and the pictures in full size."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from activestructure_gym.evaluation.archive.store import REPLAY, Run

_FILES = {
    "replay": REPLAY,
    "views": "views.png",
    "plan": "plan.png",
    "planes": "psg_plan.png",
    "planes in 3D": "psg_3d.png",
}


class Link(NamedTuple):
    """A word and where it leads."""

    name: str
    address: str  # relative to the page


def run_links(run: Run, directory: Path | None) -> list[Link]:
    """The files of a run that are there, its replay first, as a page in ``directory`` reaches them.

    Of runs beside the page or in a directory beside its own; the way to others would tell where they lie on a disk.
    Without a directory there are none.
    """
    if directory is None:
        return []
    place = os.path.relpath(run.directory, directory).replace(os.sep, "/")
    if place.startswith("../../") or os.path.isabs(place):
        return []
    return [Link(name, f"{quote(place)}/{file}") for name, file in _FILES.items() if (run.directory / file).is_file()]


def replay_link(run: Run, directory: Path | None) -> Link | None:
    """The link to a run's replay, None where there is none."""
    return next((link for link in run_links(run, directory) if link.name == "replay"), None)
