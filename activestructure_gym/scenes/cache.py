"""Arrays that are slow to compute, kept on disk under a name that says all they depend on."""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

# Part of every key: raise it when the meaning of any cached array changes.
CACHE_VERSION = 2


def cache_directory() -> Path:
    """``$ASG_CACHE_DIR``, or ``~/.cache/activestructure_gym``."""
    given = os.environ.get("ASG_CACHE_DIR")
    return Path(given) if given else Path(os.path.expanduser("~/.cache/activestructure_gym"))


def cached_arrays(key: str, compute: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """What ``compute`` returns, from disk where it has been computed before.

    Two processes may compute the same key at once; each writes a file of its own and moves it into place, so a
    reader sees nothing or everything. Without a writable directory the result is computed every time.
    """
    file = cache_directory() / f"{key}-v{CACHE_VERSION}.npz"
    arrays = _read(file)
    if arrays is None:
        arrays = compute()
        _write(file, arrays)
    return arrays


def _read(file: Path) -> dict[str, np.ndarray] | None:
    try:
        with np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None  # not there, or damaged: computed again and overwritten


def _write(file: Path, arrays: dict[str, np.ndarray]) -> None:
    temporary = None
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=file.stem, suffix=".part", delete=False) as stream:
            temporary = stream.name
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        os.replace(temporary, file)
    except OSError:  # read-only or full disk: the cache is a convenience
        if temporary is not None:
            try:
                os.unlink(temporary)
            except OSError:
                pass
