"""Folders that a process writes into before they, or their files, have their names; and what killed ones leave."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from activestructure_gym.errors import FullDisk, InputError
from activestructure_gym.evaluation.machine.processes import is_alive, machine_id
from activestructure_gym.streams import FULL

_MAX_REPORT_SECONDS = 86400.0  # seconds after which what another machine was writing counts as left behind


def temporary_suffix() -> str:
    """The end of a half-written folder's hidden name: who is writing it."""
    return f".part-{machine_id()}-{os.getpid()}"


@contextmanager
def atomic_files(directory: Path) -> Iterator[Path]:
    """A folder to write files into, which take their places in ``directory`` when the block ends without an error.

    Files of other names stay; after an error, all of them do. A place that cannot be written is an `InputError`.
    """
    new = not directory.exists()
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
        remove_leftovers(directory, "files-*", others_after=_MAX_REPORT_SECONDS)  # it may be anybody's folder
        part = Path(tempfile.mkdtemp(prefix=".files-", suffix=temporary_suffix(), dir=directory))
    try:
        with writing(directory):
            yield part
            places = {file: directory / file.relative_to(part) for file in sorted(part.rglob("*")) if file.is_file()}
            for file, place in places.items():  # before the first takes its place
                below = file.relative_to(part).parents
                refuse_links(directory, *(str(folder) for folder in below if folder.name))
                place.parent.mkdir(parents=True, exist_ok=True)
                if place.is_dir():
                    raise IsADirectoryError(errno.EISDIR, f"'{place.name}' in it is a folder")
            for file, place in places.items():
                os.replace(file, place)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        if new and not any(directory.iterdir()):
            directory.rmdir()


def refuse_links(directory: Path, *names: str) -> None:
    """Raise `InputError` if one of the files or folders of these names in ``directory`` is a link.

    A directory that somebody else made may hold links to anywhere; nothing is written through them.
    """
    for name in names:
        if (place := directory / name).is_symlink():
            raise InputError(
                f"'{place}' is a link, and nothing is written through it: remove the link, or move it away"
            )


def unlinked(path: Path) -> Path:
    """Remove ``path`` if it is a link, so that it can be written as a file of its own; what it leads to stays."""
    if path.is_symlink():
        path.unlink()
    return path


@contextmanager
def writing(place: str | os.PathLike[str]) -> Iterator[None]:
    """Make a failure to write to ``place`` an `InputError`; where there is no room, a `FullDisk`."""
    try:
        yield
    except OSError as error:
        kind = FullDisk if error.errno in FULL else InputError
        raise kind(f"'{place}' cannot be written: {error.strerror or error}") from error


def remove_leftovers(directory: Path, name: str = "*", *, others_after: float = 0.0) -> None:
    """Remove what killed processes left half-written in ``directory``, of one name or of all.

    What a living process of this machine writes is left alone, and what another machine's has begun within the last
    ``others_after`` seconds.
    """
    for part in directory.glob(f".{name}.part-*"):
        machine, _, process = part.name.rpartition(".part-")[2].partition("-")
        if machine == machine_id():
            left = not (process.isdigit() and is_alive(int(process)))
        else:
            left = _age(part) >= others_after
        if left:
            shutil.rmtree(part, ignore_errors=True)


def _age(path: Path) -> float:
    """Seconds since a folder was changed; 0 where it is gone, or the clocks of two machines differ."""
    with suppress(OSError):
        return max(0.0, time.time() - path.stat().st_mtime)
    return 0.0
