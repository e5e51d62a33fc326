"""PLY headers: what is said, and no more than what is there."""

from __future__ import annotations

import io

import pytest

from activestructure_gym.ply_header import PlyElement, PlyHeader, PlyProperty, header_bytes, read_header

QUADS = PlyHeader(
    "binary_big_endian",
    (
        PlyElement("vertex", 8, (PlyProperty("x", "float"), PlyProperty("red", "uchar"))),
        PlyElement("face", 6, (PlyProperty("vertex_indices", "int", "uchar"), PlyProperty("object_id", "int"))),
    ),
)
TEXT = b"""ply
format binary_big_endian 1.0
comment by hand
element vertex 8
property float x
property uchar red
element face 6
property list uchar int vertex_indices
property int object_id
end_header
"""


def test_written_by_hand_and_read_again() -> None:
    assert header_bytes(QUADS, ["by hand"]) == TEXT
    file = io.BytesIO(TEXT + b"data")
    assert read_header(file) == QUADS and file.read() == b"data"
    assert read_header(io.BytesIO(TEXT.replace(b"\n", b"\r\n"))) == QUADS


def test_another_file_is_none() -> None:
    assert read_header(io.BytesIO(b"")) is None
    assert read_header(io.BytesIO(b"plywood\n" + TEXT)) is None


@pytest.mark.parametrize("length", range(4, len(TEXT) - 12, 7))
def test_one_that_is_cut_off_is_not_complete(length: int) -> None:
    header = read_header(io.BytesIO(TEXT[:length]))
    assert header is not None and not header.complete


@pytest.mark.parametrize(
    "line",
    [
        "nonsense", "format", "element vertex 3", "element extra -1", "element extra 1e9",
        "element extra " + "9" * 5000, "element extra", "property float", "property list uchar x",
    ],
)  # fmt: skip
def test_the_line_that_is_none_of_a_header_is_said(line: str) -> None:
    header = read_header(io.BytesIO(TEXT.replace(b"end_header", line.encode() + b"\nend_header")))
    assert header is not None and header.unreadable == line[:80] and not header.complete
    assert [element.name for element in header.elements] == ["vertex", "face"]


def test_a_file_without_an_end_is_not_read_to_its_end() -> None:
    for more in (b"comment here\n", b"x", b"obj_info "):
        file = io.BytesIO(TEXT.replace(b"end_header\n", b"comment " + more * (4 << 20)))
        header = read_header(file)
        assert header is not None and not header.complete and file.tell() < 1_100_000
