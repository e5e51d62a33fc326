"""The page of a replay: one HTML file with the recordings, the script that draws them, and nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from activestructure_gym.evaluation.replay.packing import pack
from activestructure_gym.evaluation.replay.recording import Recording
from activestructure_gym.files import replaced
from activestructure_gym.viewer import viewer_page


def replay_page(recordings: Sequence[Recording]) -> str:
    """The whole page: one recording, or two side by side on one clock."""
    names = [f"{one.run.policy} · {one.run.scene} · seed {one.run.job.seed}" for one in recordings]
    return viewer_page(" against ".join(names), [pack(one) for one in recordings])


def write_replay(recordings: Sequence[Recording], path: Path) -> int:
    """Write the page, whole or not at all; returns its bytes."""
    page = replay_page(recordings).encode()
    with replaced(path) as file:
        file.write(page)
    return len(page)
