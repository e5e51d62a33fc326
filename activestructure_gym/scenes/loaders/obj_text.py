"""Convert Wavefront OBJ for trimesh: absolute indices, concave polygons as triangles, no comments after numbers.

trimesh counts a negative index from the end of the file. The format counts it from its own line, so files with vertices
in blocks (examples of tinyobjloader and three.js, CAD exporters) would lose their shape. trimesh also makes a fan of
every polygon (see `polygons`). Files with neither are unchanged.
"""

from __future__ import annotations

import re

import numpy as np

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.polygons import triangulated_if_concave

_RELATIVE = re.compile(r"^f[^\n]*-\d", re.MULTILINE)
_POLYGON = re.compile(r"^f(?: +[-\d/]+){4}", re.MULTILINE)
_COMMENT = re.compile(r"#[^\n]*")
_COUNTED = ("v", "vt", "vn")  # kinds of lines to which the three numbers of a corner refer, in order


def plain_obj(text: str) -> str:
    """Return the text of an OBJ file in a form that trimesh reads correctly, with the same surface.

    Indices are absolute, concave polygons are split into triangles, and leading blanks and comments after numbers are
    removed.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", "").replace("\t", " ")
    text = re.sub(r"^ +", "", text, flags=re.MULTILINE)
    text = _COMMENT.sub(_without_numbers_comment, text)
    relative, polygons = bool(_RELATIVE.search(text)), bool(_POLYGON.search(text))
    if not relative and not polygons:
        return text
    lines = text.split("\n")
    if relative:
        _make_absolute(lines)
    if polygons:
        _split_concave(lines)
    return "\n".join(lines)


def _without_numbers_comment(comment: re.Match[str]) -> str:
    """Return "" for a comment after numbers, which trimesh would parse; return other comments unchanged."""
    line = comment.string.rfind("\n", 0, comment.start()) + 1
    return "" if comment.string.startswith(("f ", "v ", "vt ", "vn "), line, comment.start()) else comment[0]


def _make_absolute(lines: list[str]) -> None:
    """Replace relative indices in ``lines``, which count back from the entries above their line, by absolute ones."""
    above = [0, 0, 0]
    for number, line in enumerate(lines):
        kind = line.partition(" ")[0]
        if kind in _COUNTED:
            above[_COUNTED.index(kind)] += 1
        elif kind == "f" and "-" in line:
            corners = [corner.split("/") for corner in line.split()[1:]]
            lines[number] = "f " + " ".join("/".join(map(_absolute, corner, above)) for corner in corners)


def _absolute(index: str, above: int) -> str:
    if not index.startswith("-"):
        return index
    absolute = above + 1 + int(index)
    if absolute < 1:
        raise UnreadableMesh(f"a face refers {index[1:]} entries back, but only {above} precede it")
    return str(absolute)


def _split_concave(lines: list[str]) -> None:
    faces = [number for number, line in enumerate(lines) if line.startswith("f ") and line.count(" ") > 3]
    corners = [lines[number].split()[1:] for number in faces]
    index = np.array([int(c.partition("/")[0]) for face in corners for c in face], dtype=np.int64) - 1
    vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64)
    if not len(index) or index.min() < 0 or index.max() >= len(vertices):  # reported by the loader
        return
    sizes = np.array([len(face) for face in corners], dtype=np.int64)
    for face, triangles in triangulated_if_concave(vertices[index], sizes).items():
        names = corners[face]
        lines[faces[face]] = "\n".join(f"f {names[a]} {names[b]} {names[c]}" for a, b, c in triangles.tolist())
