"""Define ``asg cache``, which shows or removes the files that are kept between runs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro

from activestructure_gym.evaluation.cli.fields import Switch
from activestructure_gym.evaluation.cli.listing import print_json
from activestructure_gym.evaluation.cli.output import make_console, plain_table, print_whole
from activestructure_gym.streams import escape


@dataclass(frozen=True)
class Cache:
    """Show or remove files that are kept between runs.

    These are data computed from scenes, and compiled kernels. The cache of scenes stays below ASG_CACHE_MAX, by
    default 4GiB; the least recently used files are removed first.
    """

    what: Annotated[Literal["show", "clear"], tyro.conf.Positional] = "show"
    """Show the files, or remove them."""
    part: Annotated[Literal["all", "scenes", "kernels"], tyro.conf.Positional] = "all"
    """Show or remove this part; it is computed or compiled again when needed."""
    json: Switch = False
    """Print JSON."""

    def run(self) -> int:
        """Show the files, or remove them; files that are in use are kept."""
        parts = ("scenes", "kernels") if self.part == "all" else (self.part,)
        rows = [(_clear if self.what == "clear" else _show)(part) for part in parts]
        if self.json:
            return print_json(rows)
        console = make_console()
        if self.what == "clear":
            for row in rows:
                console.print(f"{row['part']}: {row['files']} files removed, {_megabytes(row['bytes'])}")
            return 0
        table = plain_table("Kept between runs", "part", "files", "size", "at most", "where")
        for row in rows:
            most = "no limit" if row["limit"] is None else _megabytes(row["limit"])
            place = escape(str(row["place"]))
            table.add_row(str(row["part"]), str(row["files"]), _megabytes(row["bytes"]), most, place)
        print_whole(console, table)
        console.print("Remove: asg cache clear; one part: asg cache clear scenes, asg cache clear kernels.")
        console.print("Place and size are set by ASG_CACHE_DIR, ASG_CACHE_MAX and NUMBA_CACHE_DIR.")
        return 0


def _show(part: str) -> dict[str, Any]:
    from activestructure_gym.scenes.cache import cache_directory, cache_files, cache_limit

    if part == "scenes":
        sizes = [size for _, size in cache_files()]
        return _row(part, len(sizes), sum(sizes)) | {"limit": cache_limit(), "place": str(cache_directory())}

    from activestructure_gym.compiling.files import cache_place, kernel_files

    sizes = [file.stat().st_size for file in kernel_files()]
    place = cache_place()
    if place is None:
        where = "nowhere: no directory for them can be written"
    elif place.name == "__pycache__":
        where = f"next to the sources in {place.parents[1]}"
    else:
        where = str(place.parent)
    return _row(part, len(sizes), sum(sizes)) | {"limit": None, "place": where}


def _clear(part: str) -> dict[str, Any]:
    from activestructure_gym.scenes.cache import clear_cache

    if part == "scenes":
        return _row(part, *clear_cache())

    from activestructure_gym.compiling.files import kernel_files

    count, freed = 0, 0
    for file in kernel_files():
        with suppress(OSError):  # another process has removed the file, or it belongs to another user
            size = file.stat().st_size
            file.unlink()
            count, freed = count + 1, freed + size
    return _row(part, count, freed)


def _row(part: str, files: int, size: int) -> dict[str, Any]:
    return {"part": part, "files": files, "bytes": size}


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"
