"""Read cached files only if no untrusted user can have written them.

A cache may be in a folder that other users can write, with predictable file names. Trusted are this user, root, and
users who can also write the code that reads the cached file. On systems without numeric user ids (Windows) there is no
check.
"""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO

from activestructure_gym.errors import InputWarning

_said: list[str] = []  # contains the first refused path once the warning was given: there is one warning per process


def open_own(path: Path, code: str = __file__) -> IO[bytes]:
    """Open a cached file for reading; ``code`` is the path of the source file that reads it.

    Raises `OSError`, after one warning, for a file that an untrusted user can have written, and for a link or a pipe.
    """
    file = open(path, "rb", opener=_open_no_link)
    state = os.fstat(file.fileno())
    if stat.S_ISREG(state.st_mode) and not _is_of_others(state, code):
        return file
    file.close()
    if not _said:
        _said.append(str(path))
        text = f"'{path}' may have been written by another user: it and similar files are not used"
        warnings.warn(text, InputWarning, stacklevel=2)
    raise PermissionError(f"'{path}' may have been written by another user")


def guard(place: int | Path) -> None:
    """Remove the write permission of group and others from an open file (descriptor) or a folder of this user."""
    with suppress(OSError):  # owned by another user, or a file system without permissions
        mode = stat.S_IMODE(os.stat(place).st_mode)
        if os.name == "posix" and mode & (stat.S_IWGRP | stat.S_IWOTH):
            os.chmod(place, mode & ~(stat.S_IWGRP | stat.S_IWOTH))


def folder_of_others(folders: Iterable[Path], code: str = __file__) -> Path | None:
    """Return the first of ``folders`` in which untrusted users can replace files, or None; ``code`` as in `open_own`.

    A folder that its group can write is accepted, because files are checked one by one. A sticky folder such as
    ``/tmp`` is accepted too, because only the owner of a file can remove it there. Missing folders are accepted.
    """
    for folder in folders:
        with suppress(OSError):
            if _is_of_others(folder.stat(), code):
                return folder
    return None


def _open_no_link(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))


def _is_of_others(state: os.stat_result, code: str) -> bool:
    """Return whether an untrusted user owns or may write a file or folder.

    ``state`` is the stat of the file or folder; ``code`` as in `open_own`.
    """
    if os.name != "posix":
        return False
    owners, writers = {os.geteuid(), 0}, stat.S_IWGRP | stat.S_IWOTH
    if stat.S_ISDIR(state.st_mode):
        writers = 0 if state.st_mode & stat.S_ISVTX else stat.S_IWOTH
    with suppress(OSError):
        like = os.stat(code)
        owners.add(like.st_uid)
        writers &= ~like.st_mode
    return state.st_uid not in owners or bool(state.st_mode & writers)
