"""Write a replay as one HTML file that contains the recordings and the viewer, and loads no other file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from activestructure_gym.evaluation.replay.packing import pack
from activestructure_gym.evaluation.replay.recording import Recording
from activestructure_gym.files import replaced
from activestructure_gym.viewer import viewer_page


def replay_page(recordings: Sequence[Recording]) -> str:
    """Return the page of one recording, or of two recordings side by side with a common time control.

    Parameters
    ----------
    recordings
        One or two recordings.

    Returns
    -------
    str
        HTML of the page.
    """
    names = [f"{one.run.policy} · {one.run.scene} · seed {one.run.job.seed}" for one in recordings]
    return viewer_page(" and ".join(names), [pack(one) for one in recordings])


def write_replay(recordings: Sequence[Recording], path: Path) -> int:
    """Write the page of one or two recordings completely or not at all.

    Parameters
    ----------
    recordings
        One or two recordings.
    path
        The HTML file; an existing one is replaced.

    Returns
    -------
    int
        Size of the file in bytes.
    """
    page = replay_page(recordings).encode()
    with replaced(path) as file:
        file.write(page)
    return len(page)
