"""Check the output directory of a comparison before anything is written."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, store, temporary
from activestructure_gym.evaluation.archive.directory_lock import LOCK, check_free
from activestructure_gym.evaluation.running.engines.base import LOGS


def check_output(directory: Path, *, resume: bool, shared: bool = False) -> None:
    """Raise `InputError` for a directory that cannot be written or holds other files.

    With ``resume`` or ``shared``, it may hold a comparison.
    """
    if directory.is_symlink() and not directory.exists():
        raise InputError(f"the output '{directory}' is a link that leads nowhere: mend it, or choose another --out")
    if directory.exists() and not directory.is_dir():
        raise InputError(f"the output '{directory}' is a file; give a new or empty directory, or a comparison's")
    if directory.is_dir():
        temporary.refuse_links(directory, LOCK, LOGS, store.TABLES)
        if (directory / completion.JOBS).is_symlink() and not (directory / completion.JOBS).is_dir():
            raise InputError(
                f"'{directory / completion.JOBS}' is a link that leads to no folder: mend it, or remove it"
            )
        check_free(directory, shared=shared)
        if (directory / store.COMPARISON).is_file():
            if not (resume or shared):
                raise already_begun(directory)
        elif resume and (directory / completion.JOBS).is_dir():
            pass  # the record is lost, but the runs still exist
        elif any(not _is_ours(path) for path in directory.iterdir()):
            raise InputError(f"the output '{directory}' holds other files; give a directory that is new or empty")
    parent = directory
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise InputError(f"the output '{directory}' cannot be made: '{parent}' is a file")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(f"the output '{directory}' cannot be written: no permission in '{parent}'")
    try:  # on some file systems `os.access` is not reliable
        os.rmdir(tempfile.mkdtemp(prefix=f".{store.COMPARISON}.", dir=parent))
    except OSError as error:
        raise InputError(f"the output '{directory}' cannot be written: {error.strerror} in '{parent}'") from None


def already_begun(directory: Path) -> InputError:
    """Return the `InputError` about a directory that holds a comparison already."""
    return InputError(
        f"'{directory}' holds a comparison already; add --resume (in Python resume=True), or choose another directory"
    )


def _is_ours(path: Path) -> bool:
    """Return whether a file can be a leftover of a comparison that was killed before it wrote ``compare.json``."""
    return path.name == LOCK or path.name.startswith(f".{store.COMPARISON}.")
