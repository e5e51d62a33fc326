"""Limit what one scene may read and allocate, since files may come from anyone.

A file of a few kilobytes can request gigabytes or hours: by counts in its header, by placing one mesh a million times,
by single-colour images, or by naming a device. Every reader takes from the scene's one budget before it allocates. A
limit is an allowance plus a share per byte read, so large scans pass and small files stay small scenes. All allowances
together stay below 2 GB of memory and a minute on one core.
"""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

from activestructure_gym.scenes.loaders.damage import UnreadableMesh

MAX_BYTES = 4 << 30  # maximum size of all files of a scene; they are held in memory while they are read


@dataclass(frozen=True)
class Limit:
    """Define a limit: ``allowance + per_byte * bytes read``, at most ``ceiling``; ``remedy`` ends the error message."""

    allowance: int
    per_byte: float
    ceiling: int
    remedy: str

    def at(self, bytes_read: int) -> int:
        """Return the limit for a scene of which ``bytes_read`` bytes were read."""
        return min(self.ceiling, self.allowance + int(self.per_byte * bytes_read))


# The numbers per byte exceed the needs of any file without repetition: a triangle of 16-bit indices has 6 bytes, a
# quantised vertex 4, and an image rarely less than half a bit per pixel. The allowances are for instances, which
# multiply the content of a file.
LIMITS = {
    "triangles": Limit(3_000_000, 0.25, 50_000_000, "decimate its meshes or place fewer copies of them"),
    "vertices": Limit(5_000_000, 0.5, 150_000_000, "decimate its meshes or place fewer copies of them"),
    "nodes": Limit(100_000, 0.1, 10_000_000, "join its nodes"),
    "meshes and copies of them": Limit(50_000, 0.005, 1_000_000, "join its meshes by material"),
    "numbers in arrays": Limit(30_000_000, 4.0, 2_000_000_000, "write each array once"),
    "bytes of pictures": Limit(64 << 20, 2.0, MAX_BYTES, "write each picture once"),
    "pixels": Limit(1_000_000_000, 16.0, 20_000_000_000, "make its pictures smaller"),
    "pixels after shrinking": Limit(64_000_000, 16.0, 4_000_000_000, "make its pictures smaller or max_texture lower"),
}


class LimitError(UnreadableMesh):
    """Report that a scene exceeds a limit; the message completes a sentence that begins with the name of the file."""


@dataclass
class SceneBudget:
    """Count how much a scene has read and allocated, and compare it with `LIMITS`."""

    bytes_read: int = 0
    taken: dict[str, int] = field(default_factory=dict)
    _files: set[tuple[int, int]] = field(default_factory=set)  # device and inode: each file counts once

    def read(self, path: Path) -> bytes:
        """Return the content of a regular file, and count its size; raise `LimitError` for devices and pipes."""
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):
            raise LimitError(f"'{path.name}' is a device or a pipe, not a file")
        if (status.st_dev, status.st_ino) not in self._files:
            self._files.add((status.st_dev, status.st_ino))
            self.bytes_read += status.st_size
        if self.bytes_read > MAX_BYTES:
            raise LimitError(f"its files have more than {MAX_BYTES >> 30} GB; decimate its meshes or split it")
        with open(path, "rb") as stream:
            return stream.read(status.st_size)  # files in /proc have size 0 and may never end

    def take(self, what: str, count: int) -> None:
        """Count ``count`` more of ``what`` (a key of `LIMITS`); raise `LimitError` above the limit."""
        total = self.taken.get(what, 0) + count
        limit = LIMITS[what]
        if total > (most := limit.at(self.bytes_read)):
            raise LimitError(
                f"it has more than {most:,} {what}, the limit for files of {self.bytes_read:,} bytes; {limit.remedy}"
            )
        self.taken[what] = total
