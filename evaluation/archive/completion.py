"""Mark runs as finished, withdraw them, and write their directories whole or not at all."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from activestructure_gym.evaluation.archive import schema
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.temporary import temporary_suffix

DONE = ".done"
PLAYED = ".played"  # used instead of `DONE` until the episode is measured, see `played`
WITHDRAWN = ".withdrawn"  # the former `DONE` of a run whose plug-in code or native settings have changed
JOBS = "jobs"  # sub-directory of a comparison: one run directory per finished job


def is_done(directory: Path, job: Job) -> bool:
    """Return whether ``directory`` has the completion marker of this job; `damage_of` also checks the files."""
    return marker_and_checksums(directory)[0] == job.hash


def marker_and_checksums(directory: Path, marker: str = DONE) -> tuple[str, dict[str, str]]:
    """Read a marker file: return the job's hash and the checksums by file name, both empty if it does not exist."""
    try:
        with open(directory / marker, "rb") as file:
            first, *lines = file.read(1 << 16).decode("ascii", "replace").splitlines() or [""]
    except OSError:
        return "", {}
    pairs = (line.split("  ", 1) for line in lines if "  " in line)
    return first.strip(), {name: digest for digest, name in pairs}


def checksum_of(path: Path) -> str:
    """Return the SHA-256 of a file; raise `Mismatch` if it is not a regular file."""
    if path.exists() and not path.is_file():
        raise schema.Mismatch("it is not a regular file")
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_marker(directory: Path, marker: str, job: Job, names: Iterable[str]) -> None:
    """Write a file with the job's hash and the checksums of the named files that exist."""
    lines = [job.hash]
    lines += [f"{checksum_of(directory / name)}  {name}" for name in names if (directory / name).is_file()]
    (directory / marker).write_text("\n".join(lines) + "\n", encoding="utf-8")


def completion_markers(directory: Path) -> list[Path]:
    """Return the completion markers of a comparison's runs; runs in temporary folders are left out."""
    markers = (directory / JOBS).glob(f"*/{DONE}")  # also matches hidden folders
    return sorted(marker for marker in markers if not marker.parent.name.startswith("."))


def set_aside(directory: Path) -> None:
    """Remove the completion marker of a damaged run. Its files are kept until a new run replaces them.

    If the run's directory is a symbolic link, only the link is removed.
    """
    if not _remove_link(directory):
        (directory / DONE).unlink(missing_ok=True)


def withdraw(directory: Path) -> None:
    """Rename the completion marker of a run, so that the run counts as unfinished; `reinstate` restores it."""
    if not _remove_link(directory):
        with suppress(FileNotFoundError):  # another process was faster
            os.replace(directory / DONE, directory / WITHDRAWN)


def _remove_link(directory: Path) -> bool:
    """Remove a run's directory if it is a symbolic link, not its target; return whether it was one."""
    if not directory.is_symlink():
        return False
    directory.unlink(missing_ok=True)
    return True


def reinstate(directory: Path) -> None:
    """Restore the completion marker of a withdrawn run."""
    with suppress(FileNotFoundError):
        os.replace(directory / WITHDRAWN, directory / DONE)


def is_withdrawn(directory: Path) -> bool:
    """Return whether the directory holds a withdrawn run."""
    return (directory / WITHDRAWN).is_file() and not (directory / DONE).exists()


@contextmanager
def atomic_directory(directory: Path) -> Iterator[Path]:
    """Yield a temporary directory; it is renamed to ``directory`` when the block ends without an error.

    An existing ``directory`` is replaced, unless it holds the finished run of the same job: another process was faster,
    and equal jobs give equal results. A symbolic link is replaced itself, not its target. All content is flushed to the
    disk before the rename. After an error or Ctrl-C the temporary directory is removed.
    """
    directory.parent.mkdir(parents=True, exist_ok=True)
    part = directory.parent / f".{directory.name}{temporary_suffix()}"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    try:
        yield part
        if _same_result(part, directory):
            return
        _flush(part)
        aside = aside_of(directory)
        if directory.exists() or directory.is_symlink():  # a dangling link does not exist, but is replaced
            _remove(aside)
            with suppress(FileNotFoundError):  # another process was faster
                os.replace(directory, aside)
        try:
            os.replace(part, directory)
        except OSError:
            if not _same_result(part, directory):
                raise
        _remove(aside)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _remove(place: Path) -> None:
    """Remove a directory, a file, or a symbolic link without its target; ignore errors."""
    with suppress(OSError):
        place.unlink() if place.is_symlink() or not place.is_dir() else shutil.rmtree(place)


def aside_of(directory: Path) -> Path:
    """Return the path to which a run's directory is moved while a new one replaces it."""
    directory = directory.absolute()  # the name of "." is empty; "/" has none
    return directory.parent / f".{directory.name}.aside"


def _same_result(part: Path, directory: Path) -> bool:
    """Return whether ``directory`` holds the finished run of the same job as the temporary folder ``part``."""
    marker = marker_and_checksums(directory)[0]
    return bool(marker) and marker in (marker_and_checksums(part)[0], marker_and_checksums(part, PLAYED)[0])


def _flush(directory: Path) -> None:
    """Flush all files of ``directory`` to the disk, so that a power failure cannot leave empty files."""
    if os.name != "posix":
        return
    for path in (*directory.rglob("*"), directory):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        except OSError:
            pass  # not supported by the file system
        finally:
            os.close(descriptor)
