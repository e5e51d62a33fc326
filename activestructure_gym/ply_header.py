"""Parse and write headers of PLY files, which may be damaged or made to attack the reader.

A header consists of lines of ASCII words from ``ply`` to ``end_header``. It states the format, and then the elements
(tables) with their number of records and their properties (columns) ([turk1994]). This module does not check whether
the data can be read; the readers of the data report that.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import IO

MAGIC = b"ply"
BINARY_LITTLE_ENDIAN, BINARY_BIG_ENDIAN = "binary_little_endian", "binary_big_endian"
NUMPY_ORDERS = {BINARY_LITTLE_ENDIAN: "<", BINARY_BIG_ENDIAN: ">"}
NUMPY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_MAX_BYTES = 1 << 20  # a file without end_header is read up to this number of bytes
_MAX_DIGITS = 18  # largest number of digits of a count, which then fits into 64 bits


@dataclass(frozen=True)
class PlyProperty:
    """Describe one column of an element: a number per record, or a list of numbers preceded by its length.

    Types are named as in the file.
    """

    name: str
    kind: str  # "float", "uchar", ...; possibly a type that `NUMPY_TYPES` lacks
    count_kind: str = ""  # type of the list's length; "" for a single number

    def __str__(self) -> str:
        return f"list {self.count_kind} {self.kind} {self.name}" if self.count_kind else f"{self.kind} {self.name}"


@dataclass(frozen=True)
class PlyElement:
    """Describe one table of the file: its name, its number of records and its columns."""

    name: str
    count: int
    properties: tuple[PlyProperty, ...]


@dataclass(frozen=True)
class PlyHeader:
    """Hold the content of a PLY header up to the first line that could not be parsed."""

    format: str  # "ascii", `BINARY_LITTLE_ENDIAN`, ...; "" if the header has none
    elements: tuple[PlyElement, ...]  # in the order of the data, with unique names
    complete: bool = True  # whether end_header was found; the data begin after it
    unreadable: str = ""  # first line that could not be parsed, at most 80 characters; "" if there is none


def read_header(file: IO[bytes]) -> PlyHeader | None:
    """Parse the PLY header at the beginning of a file, and leave the file position at the data.

    Returns None if the file is not a PLY file. At most 1 MiB is read.
    """
    if file.readline(8).strip() != MAGIC:
        return None
    form = ""
    elements: dict[str, tuple[int, list[PlyProperty]]] = {}

    def header(*, complete: bool, unreadable: str = "") -> PlyHeader:
        found = tuple(PlyElement(name, count, tuple(own)) for name, (count, own) in elements.items())
        return PlyHeader(form, found, complete, unreadable)

    left = _MAX_BYTES
    while line := file.readline(left):
        left -= len(line)
        match line.decode("ascii", errors="replace").split():
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["end_header", *_]:
                return header(complete=True)
            case ["format", form, *_]:
                continue
            case ["element", name, count] if name not in elements and count.isdigit() and len(count) <= _MAX_DIGITS:
                elements[name] = int(count), []
            case ["property", "list", count_kind, kind, name] if elements:
                elements[next(reversed(elements))][1].append(PlyProperty(name, kind, count_kind))
            case ["property", kind, name] if elements:
                elements[next(reversed(elements))][1].append(PlyProperty(name, kind))
            case words:
                return header(complete=False, unreadable=" ".join(words)[:80])
    return header(complete=False)


def header_bytes(header: PlyHeader, comments: Iterable[str] = ()) -> bytes:
    """Return the header as bytes, with ``comments`` after the format line."""
    lines = [MAGIC.decode(), f"format {header.format} 1.0", *(f"comment {text}" for text in comments)]
    for element in header.elements:
        lines.append(f"element {element.name} {element.count}")
        lines += [f"property {one}" for one in element.properties]
    return "\n".join([*lines, "end_header\n"]).encode()
