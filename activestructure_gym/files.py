"""Replace files atomically: a file is written completely or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

UNFINISHED = ".*.tmp"  # pattern of temporary files left by a killed process


@contextmanager
def replaced(path: str | os.PathLike[str], *, durable: bool = False) -> Iterator[IO[bytes]]:
    """Open a temporary binary file that replaces ``path`` when the block ends; readers see the old or the new content.

    Parameters
    ----------
    path : str or path
        The file to replace; its directory must exist. After an error, including Ctrl-C, it is unchanged.
    durable : bool
        Whether to flush the content to disk before the rename, so that a power cut cannot leave an empty file.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.tmp")
    try:
        with open(temporary, "wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
