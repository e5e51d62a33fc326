"""Write a finished run as a video: the image of ``render()`` after each keyframe."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import cv2

from activestructure_gym.errors import FullDisk, InputError, InputWarning
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.replay.recording import replay_actions, replay_env
from activestructure_gym.viewer.recorder import after_keyframes

# OpenCV's codec by file extension. Players and editors read MPEG-4. Browsers also read VP9, which is written slower.
CODECS = {".mp4": "mp4v", ".webm": "VP90"}
FRAMES_PER_SECOND = 10.0
_LAST_REPEATS = 20  # the last image is shown 2 s longer


def check_video(path: Path) -> str:
    """Return the codec of a video file.

    Parameters
    ----------
    path
        The video file; its extension selects the codec.

    Returns
    -------
    str
        Four letters of the codec, as OpenCV names it.

    Raises
    ------
    InputError
        If the extension is not one of `CODECS`.
    """
    if path.suffix.lower() not in CODECS:
        raise InputError(f"a video ends in {' or '.join(CODECS)}, got '{path.name}'")
    return CODECS[path.suffix.lower()]


def is_complete(path: Path, images: int) -> bool:
    """Return whether a video file contains the given number of images."""
    video = cv2.VideoCapture(str(path))
    try:
        return sum(1 for _ in iter(video.grab, False)) == images  # the header's count includes images never written
    finally:
        video.release()


def write_video(
    run: Run,
    path: Path,
    report_progress: Callable[[int, int], None] = lambda frames, budget: None,
    *,
    trusted: bool = False,
) -> float:
    """Replay a stored run and write a video of ten keyframes per second, completely or not at all.

    Warn if the replay differs from the stored run.

    Parameters
    ----------
    run
        The stored run.
    path
        The video file; see `check_video`.
    report_progress, trusted
        As in `play_again`.

    Returns
    -------
    float
        Length of the video in seconds.

    Raises
    ------
    InputError
        For another file extension, if the run cannot be replayed, or if OpenCV cannot write the file.
    FullDisk
        If the file is incomplete after writing.
    """
    from activestructure_gym.envs.panel import draw_panel

    codec, images = check_video(path), 0
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    with replay_env(run, trusted=trusted) as env:
        episode = env.reconstruction
        first = draw_panel(episode, episode.mapper.keyframes[-1])
        size = first.shape[1], first.shape[0]
        writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*codec), FRAMES_PER_SECOND, size)
        if not writer.isOpened():
            raise InputError(f"this OpenCV cannot write '{path}': try another ending of {', '.join(CODECS)}")

        def add(times: int = 1) -> None:
            nonlocal images
            image = cv2.cvtColor(draw_panel(episode, episode.mapper.keyframes[-1]), cv2.COLOR_RGB2BGR)
            for _ in range(times):
                writer.write(image)
            images += times

        try:
            add()
            after_keyframes(episode, add)
            if divergence := replay_actions(run, env, lambda row: None, report_progress):
                warnings.warn(f"the video of {run.job.title}: {divergence}", InputWarning, stacklevel=2)
            add(_LAST_REPEATS)
            writer.release()
            if not is_complete(part, images):  # OpenCV raises no error on a full disk
                raise FullDisk(f"'{path}' cannot be written whole: is there room on its disk?")
            part.replace(path)
        finally:
            writer.release()
            part.unlink(missing_ok=True)
    return images / FRAMES_PER_SECOND
