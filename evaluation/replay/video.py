"""Write a film of one or two replayed runs as a video, or as an animated image."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from activestructure_gym.errors import FullDisk, InputError
from activestructure_gym.evaluation.replay.film import IMAGES_PER_SECOND, PLAYED_S, STILL_S, film_images
from activestructure_gym.evaluation.replay.recording import Recording

# OpenCV's codec by file extension. Players and editors read MPEG-4. Browsers also read VP9, which is written slower.
CODECS = {".mp4": "mp4v", ".webm": "VP90"}
ANIMATED = ".webp"  # an animated image, which README and other pages show without a player
_QUALITY = 60  # of the animated image, in percent


def check_video(path: Path) -> None:
    """Raise `InputError` if the extension of ``path`` is not that of a video or of an animated image."""
    endings = [*CODECS, ANIMATED]
    if path.suffix.lower() not in endings:
        raise InputError(f"a video ends in {', '.join(endings[:-1])} or {endings[-1]}, got '{path.name}'")


def is_complete(path: Path, images: int) -> bool:
    """Return whether a video file contains the given number of images."""
    video = cv2.VideoCapture(str(path))
    try:
        return sum(1 for _ in iter(video.grab, False)) == images  # the header's count includes images never written
    finally:
        video.release()


def write_video(recordings: Sequence[Recording], path: Path) -> float:
    """Write the film of one or two recordings completely or not at all.

    Parameters
    ----------
    recordings
        One or two recordings, shown side by side; see `film.film_images`.
    path
        The video file; its extension is one of `CODECS`, or `ANIMATED`.

    Returns
    -------
    float
        Length of the film in seconds.

    Raises
    ------
    InputError
        For another file extension, or if OpenCV cannot write the file.
    FullDisk
        If the file is incomplete after writing.
    """
    check_video(path)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    write: Callable[[Iterator[np.ndarray], Path], None]
    write = _write_animated if path.suffix.lower() == ANIMATED else _write_video
    try:
        write(film_images(recordings), part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return PLAYED_S + STILL_S


def _write_animated(images: Iterator[np.ndarray], path: Path) -> None:
    first, *others = [Image.fromarray(image) for image in images]
    times = [round(1000 / IMAGES_PER_SECOND)] * (len(others) + 1)
    times[-1] += round(1000 * STILL_S)
    first.save(path, save_all=True, append_images=others, duration=times, loop=0, quality=_QUALITY, method=4)


def _write_video(images: Iterator[np.ndarray], path: Path) -> None:
    count, writer = 0, None
    try:
        for image in images:
            bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
            if writer is None:
                codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix.lower()])
                writer = cv2.VideoWriter(str(path), codec, float(IMAGES_PER_SECOND), (image.shape[1], image.shape[0]))
                if not writer.isOpened():
                    raise InputError(f"this OpenCV cannot write '{path.suffix}': try {', '.join(CODECS)} or {ANIMATED}")
            writer.write(bgr)
            count += 1
        assert writer is not None
        for _ in range(round(STILL_S * IMAGES_PER_SECOND)):
            writer.write(bgr)
            count += 1
    finally:
        if writer is not None:
            writer.release()
    if not is_complete(path, count):  # OpenCV raises no error on a full disk
        raise FullDisk(f"'{path.name}' cannot be written whole: is there room on its disk?")
