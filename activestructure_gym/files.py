"""Replace files atomically: readers see the complete old content or the complete new content."""

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
    """Open a temporary binary file for writing; it replaces ``path`` when the block ends.

    Parameters
    ----------
    path : str or path
        The file to replace; its directory must exist. It is unchanged after an error in the block, including Ctrl-C.
    durable : bool
        Whether to flush the content to disk before the replacement. Otherwise a power cut can leave an empty file.

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
