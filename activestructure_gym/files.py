"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

UNFINISHED = ".*.tmp"  # pattern of what a killed process leaves in a directory


@contextmanager
def replaced(path: str | os.PathLike[str], *, durable: bool = False) -> Iterator[IO[bytes]]:
    """A binary file to write into that takes its name when the block ends: readers see the old content or the new.

    Parameters
    ----------
    path : str or path
        What is replaced; its directory must exist. After an error, Ctrl-C included, it is what it was.
    durable : bool
        Whether the content is on the disk before it has its name, so that a power cut cannot leave an empty file.

    Raises
    ------
    OSError
        Where the file cannot be written.
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
