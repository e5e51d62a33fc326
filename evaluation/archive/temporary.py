"""Write files into temporary folders, move them to their places when complete, and remove leftovers."""

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

_MAX_REPORT_SECONDS = 86400.0  # age at which a temporary folder of another machine counts as a leftover


def temporary_suffix() -> str:
    """Return the suffix of a temporary folder's name: machine and process that write it."""
    return f".part-{machine_id()}-{os.getpid()}"


@contextmanager
def atomic_files(directory: Path) -> Iterator[Path]:
    """Yield a temporary folder; when the block ends without an error, its files are moved into ``directory``.

    Files of the same name are replaced, all others are kept. After an error ``directory`` is unchanged. Raise
    `InputError` if it cannot be written.
    """
    new = not directory.exists()
    with writing(directory):
        directory.mkdir(parents=True, exist_ok=True)
        remove_leftovers(directory, "files-*", others_after=_MAX_REPORT_SECONDS)
        part = Path(tempfile.mkdtemp(prefix=".files-", suffix=temporary_suffix(), dir=directory))
    try:
        with writing(directory):
            yield part
            places = {file: directory / file.relative_to(part) for file in sorted(part.rglob("*")) if file.is_file()}
            for file, place in places.items():  # check all places before the first file is moved
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
    """Raise `InputError` if one of the named entries of ``directory`` is a symbolic link.

    A directory made by another user may hold links to any file; nothing is written through them.
    """
    for name in names:
        if (place := directory / name).is_symlink():
            raise InputError(
                f"'{place}' is a link, and nothing is written through it: remove the link, or move it away"
            )


def unlinked(path: Path) -> Path:
    """Remove ``path`` if it is a symbolic link, not its target; return ``path``."""
    if path.is_symlink():
        path.unlink()
    return path


@contextmanager
def writing(place: str | os.PathLike[str]) -> Iterator[None]:
    """Turn an OSError of the block into an `InputError` about ``place``, or `FullDisk` if the disk is full."""
    try:
        yield
    except OSError as error:
        kind = FullDisk if error.errno in FULL else InputError
        raise kind(f"'{place}' cannot be written: {error.strerror or error}") from error


def remove_leftovers(directory: Path, name: str = "*", *, others_after: float = 0.0) -> None:
    """Remove temporary folders of killed processes from ``directory``; ``name`` is a pattern of the final name.

    Folders of running processes of this machine are kept. Folders of other machines are kept if they were changed less
    than ``others_after`` seconds ago.
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
    """Return the seconds since a folder was changed; 0 if it does not exist or its time is in the future."""
    with suppress(OSError):
        return max(0.0, time.time() - path.stat().st_mtime)
    return 0.0
