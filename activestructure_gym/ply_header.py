"""Parse and write headers of PLY files, which may be damaged or hostile.

A header is lines of ASCII words from ``ply`` to ``end_header``: the format, then elements with their count, each with
its properties ([turk1994]). Readers of the data report unusual headers themselves.
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
_MAX_BYTES = 1 << 20  # limit on a file without end_header
_MAX_DIGITS = 18  # of a count; fits into 64 bits


@dataclass(frozen=True)
class PlyProperty:
    """Describe one number of each record, or a list of numbers preceded by its count; types as written in the file."""

    name: str
    kind: str  # "float", "uchar", ...; may be a type missing in `NUMPY_TYPES`
    count_kind: str = ""  # type of a list's count; "" for a single number

    def __str__(self) -> str:
        return f"list {self.count_kind} {self.kind} {self.name}" if self.count_kind else f"{self.kind} {self.name}"


@dataclass(frozen=True)
class PlyElement:
    """Describe a table of the file: ``count`` records with these properties."""

    name: str
    count: int
    properties: tuple[PlyProperty, ...]


@dataclass(frozen=True)
class PlyHeader:
    """Hold the content of a header, as far as it could be read."""

    format: str  # "ascii", `BINARY_LITTLE_ENDIAN`, ...; "" if not given
    elements: tuple[PlyElement, ...]  # in data order; names are unique
    complete: bool = True  # whether end_header was found; the data follow it
    unreadable: str = ""  # first line that could not be parsed; reading stopped there


def read_header(file: IO[bytes]) -> PlyHeader | None:
    """Parse a PLY header and leave the file at its data; return None if the file is no PLY.

    The file must be at its beginning. At most 1 MiB is read.
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
    """Return the header as bytes; comments follow the format line."""
    lines = [MAGIC.decode(), f"format {header.format} 1.0", *(f"comment {text}" for text in comments)]
    for element in header.elements:
        lines.append(f"element {element.name} {element.count}")
        lines += [f"property {one}" for one in element.properties]
    return "\n".join([*lines, "end_header\n"]).encode()
