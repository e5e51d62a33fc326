"""Whose cached files are used: those that nobody else than this user, root or the owner of the code can have written.

A cache may lie in a folder that others can write, and the names in it are predictable. Whoever can write the code that
uses a cached file could have written that file as well, so a file is guarded as well as the code or it is not used.
Systems without numbers of users (Windows) are left as they are.
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

_said: list[str] = []  # the warning is given once per process


def open_own(path: Path, code: str = __file__) -> IO[bytes]:
    """Open a cached file that the file ``code`` uses for reading.

    Raises `OSError` for a file that others can have written, after one warning, and for a link or a pipe.
    """
    file = open(path, "rb", opener=_open_no_link)
    state = os.fstat(file.fileno())
    if stat.S_ISREG(state.st_mode) and not _is_of_others(state, code):
        return file
    file.close()
    if not _said:
        _said.append(str(path))
        text = f"'{path}' can have been written by another user: it is not used, nor are others like it"
        warnings.warn(text, InputWarning, stacklevel=2)
    raise PermissionError(f"'{path}' can have been written by another user")


def guard(place: int | Path) -> None:
    """Let nobody but its owner write an open file, or a folder, that this user has made."""
    with suppress(OSError):  # another user's, or a file system without permissions
        mode = stat.S_IMODE(os.stat(place).st_mode)
        if os.name == "posix" and mode & (stat.S_IWGRP | stat.S_IWOTH):
            os.chmod(place, mode & ~(stat.S_IWGRP | stat.S_IWOTH))


def folder_of_others(folders: Iterable[Path], code: str = __file__) -> Path | None:
    """Return the first of the folders in which others can put something in the place of files of this user.

    Members of its group may write a folder: their files are refused one by one. So may everybody where only the owner
    of a file can remove it, as in ``/tmp``. A folder that does not exist yet will be this user's.
    """
    for folder in folders:
        with suppress(OSError):
            if _is_of_others(folder.stat(), code):
                return folder
    return None


def _open_no_link(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))


def _is_of_others(state: os.stat_result, code: str) -> bool:
    """Whether somebody else owns a file or folder or may write it, and owns or may write the code no less."""
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
