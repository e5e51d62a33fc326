"""Convert PLY for trimesh: a simplified header with the colour names that trimesh knows.

trimesh always reads the second line as the format, and ends the header at the first line with the word end_header, even
in a comment.
"""

from __future__ import annotations

import io
import re
from dataclasses import replace

from activestructure_gym.ply_header import PlyElement, header_bytes, read_header

_COLORS = ("red", "green", "blue", "alpha")
# Names of colour properties in other programs; an element's colour is the first set of which it has the first three.
_OTHER_NAMES = tuple(
    tuple(pattern.format(color, color[0]) for color in _COLORS)
    for pattern in ("{0}", "diffuse_{0}", "{1}", "color_{0}", "colour_{0}", "vertex_{0}", "diffuse_{1}", "color_{1}")
)
_PICTURE = re.compile(rb"^comment[ \t]+TextureFile[ \t]+(.*?)[ \t\r]*$", re.MULTILINE | re.IGNORECASE)


def plain_ply(data: bytes) -> tuple[bytes, list[str]]:
    """Return the content of a PLY file with a simplified header, and the names of its images.

    trimesh reads the first image. An unreadable header is unchanged.
    """
    stream = io.BytesIO(data)
    header = read_header(stream)
    if header is None or not header.complete:
        return data, []
    start = stream.tell()
    pictures = [name.decode("utf-8", errors="replace") for name in _PICTURE.findall(data[:start])]
    header = replace(header, elements=tuple(map(_with_known_colors, header.elements)))
    comments = [f"TextureFile {name}" for name in pictures[:1]]
    return b"".join([header_bytes(header, comments), memoryview(data)[start:]]), pictures


def _with_known_colors(element: PlyElement) -> PlyElement:
    """Return the element with its colour properties renamed to red, green, blue and alpha."""
    names = {one.name.lower(): one.name for one in element.properties if not one.count_kind}
    found = next((given for given in _OTHER_NAMES if all(name in names for name in given[:3])), ())
    taken = {one.name for one in element.properties}
    known = {names[name]: color for name, color in zip(found, _COLORS) if name in names and color not in taken}
    return replace(element, properties=tuple(replace(p, name=known.get(p.name, p.name)) for p in element.properties))
