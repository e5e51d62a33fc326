"""A finished run as a video: what ``render()`` shows, after every keyframe."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import cv2

from activestructure_gym.errors import FullDisk, InputError, InputWarning
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.replay.recording import follow, playing
from activestructure_gym.viewer.recorder import after_keyframes

# By the file's ending. MPEG-4 opens in players and editors; VP9, which takes longer to write, in browsers too.
CODECS = {".mp4": "mp4v", ".webm": "VP90"}
FRAMES_PER_SECOND = 10.0
_LAST = 20  # times that the end is shown


def check_video(path: Path) -> str:
    """What a video is written with; raises `InputError` for an ending that is none of a video's."""
    if path.suffix.lower() not in CODECS:
        raise InputError(f"a video ends in {' or '.join(CODECS)}, got '{path.name}'")
    return CODECS[path.suffix.lower()]


def is_whole(path: Path, pictures: int) -> bool:
    """Return whether a file is a video of so many pictures; one that a full disk cut off is not."""
    film = cv2.VideoCapture(str(path))
    try:
        return sum(1 for _ in iter(film.grab, False)) == pictures  # its head may promise more than there is
    finally:
        film.release()


def write_video(
    run: Run, path: Path, tell: Callable[[int, int], None] = lambda frames, budget: None, *, trusted: bool = False
) -> float:
    """Play ``run`` again into a video at ``path``, ten keyframes a second, whole or not at all; returns its seconds.

    Warns where this code plays another episode than the stored one.

    Raises `InputError` for another ending, where the run cannot be played again, and where OpenCV cannot write it.
    """
    from activestructure_gym.envs.panel import draw_panel

    codec, pictures = check_video(path), 0
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    with playing(run, trusted=trusted) as env:
        episode = env.reconstruction
        first = draw_panel(episode, episode.mapper.keyframes[-1])
        size = first.shape[1], first.shape[0]
        writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*codec), FRAMES_PER_SECOND, size)
        if not writer.isOpened():
            raise InputError(f"this OpenCV cannot write '{path}': try another ending of {', '.join(CODECS)}")

        def add(times: int = 1) -> None:
            nonlocal pictures
            picture = cv2.cvtColor(draw_panel(episode, episode.mapper.keyframes[-1]), cv2.COLOR_RGB2BGR)
            for _ in range(times):
                writer.write(picture)
            pictures += times

        try:
            add()
            after_keyframes(episode, add)
            if differs := follow(run, env, lambda row: None, tell):
                warnings.warn(f"the video of {run.job.title}: {differs}", InputWarning, stacklevel=2)
            add(_LAST)
            writer.release()
            if not is_whole(part, pictures):  # OpenCV reports no error
                raise FullDisk(f"'{path}' cannot be written whole: is there room on its disk?")
            part.replace(path)
        finally:
            writer.release()
            part.unlink(missing_ok=True)
    return pictures / FRAMES_PER_SECOND
