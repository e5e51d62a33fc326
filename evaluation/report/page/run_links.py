"""Link the page to files in the directories of runs: the replay, and the images in full size."""

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
    """Hold the text and the address of a link."""

    name: str
    address: str  # relative to the page


def run_links(run: Run, directory: Path | None) -> list[Link]:
    """Return links from a page in ``directory`` to the existing files of a run, the replay first.

    Only runs in ``directory`` or next to it are linked; other addresses would reveal local paths. None as ``directory``
    gives no links.
    """
    place = relative_place(run, directory)
    return (
        []
        if place is None
        else [Link(name, f"{quote(place)}/{file}") for name, file in _FILES.items() if (run.directory / file).is_file()]
    )


def relative_place(run: Run, directory: Path | None) -> str | None:
    """Return the path of a run relative to ``directory``, or None if it is neither in it nor next to it."""
    if directory is None:
        return None
    place = os.path.relpath(run.directory, directory).replace(os.sep, "/")
    return None if place.startswith("../../") or os.path.isabs(place) else place


def replay_link(run: Run, directory: Path | None) -> Link | None:
    """Return the link from a page in ``directory`` to the replay of a run, or None if there is none."""
    return next((link for link in run_links(run, directory) if link.name == "replay"), None)
