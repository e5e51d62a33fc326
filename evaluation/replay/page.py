"""Write a replay as one HTML file that contains the recordings and the viewer, and loads no other file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from activestructure_gym.evaluation.archive.store import Run
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
    heading, names = names_of([one.run for one in recordings])
    return viewer_page(f"{heading}: {' and '.join(names)}", [pack(one, name) for one, name in zip(recordings, names)])


def names_of(runs: Sequence[Run]) -> tuple[str, list[str]]:
    """Return a heading with the scene, seed and policy that all runs share, and a name per run with those that differ.

    If all three are equal, the names are the policy. If nothing is equal, the heading is "replay".
    """
    parts = [(run.policy, run.scene, f"seed {run.job.seed}") for run in runs]
    common = [len(set(column)) == 1 for column in zip(*parts)]
    common[0] = common[0] and not all(common)
    named = [" · ".join(part for part, same in zip(one, common) if not same) for one in parts]
    return " · ".join(part for part, same in zip(parts[0], common) if same) or "replay", named


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
