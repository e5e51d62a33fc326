from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.mesh_parts import TextureStore
from activestructure_gym.scenes.loaders.plain_ply import plain_ply
from activestructure_gym.scenes.loaders.trimesh_reader import read_with_trimesh

COLORS = [[255, 0, 0], [0, 128, 0], [0, 0, 51]]


def triangle(names=("red", "green", "blue"), comments=(), before=(), *, binary=False):
    """A triangle with colours under these names, and with these lines behind and before the format."""
    kind = "binary_little_endian" if binary else "ascii"
    lines = ["ply", *before, f"format {kind} 1.0", *comments, "element vertex 3"]
    lines += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {name}" for name in names]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    header = "\n".join([*lines, ""]).encode()
    places = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    colors = [[*color, 255][: len(names)] for color in COLORS]
    if binary:
        rows = b"".join(np.array(p, "<f4").tobytes() + bytes(c) for p, c in zip(places, colors))
        return header + rows + b"\3" + np.arange(3, dtype="<i4").tobytes()
    return header + "".join(f"{' '.join(map(str, [*p, *c]))}\n" for p, c in zip(places, colors)).encode() + b"3 0 1 2\n"


def colors_of(tmp_path, data):
    (tmp_path / "a.ply").write_bytes(data)
    (part,) = read_with_trimesh(tmp_path / "a.ply", TextureStore())
    return np.rint(part.colors * 255).tolist()


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    "lines",
    [
        {"comments": ["comment this is not an end_header yet"]},
        {"comments": ["obj_info end_header", "comment element face 9", "comment", "", "comment gr\u00fcn"]},
        {"before": ["comment made before the format is said, in ascii"]},
        {"before": ["comment binary_big_endian"], "comments": ["comment end_header"]},
    ],
)
def test_lines_of_text_do_not_end_a_header(tmp_path, lines, binary):
    assert colors_of(tmp_path, triangle(binary=binary, **lines)) == COLORS


@pytest.mark.parametrize(
    "names",
    [
        ("diffuse_red", "diffuse_green", "diffuse_blue"),
        ("r", "g", "b"),
        ("R", "G", "B", "A"),
        ("Red", "Green", "Blue", "Alpha"),
        ("color_r", "color_g", "color_b"),
        ("red", "green", "blue", "alpha"),
        ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
    ],
)
def test_colours_under_other_names(tmp_path, names):
    assert colors_of(tmp_path, triangle(names)) == COLORS


def test_other_numbers_are_no_colours(tmp_path):
    assert np.ptp(colors_of(tmp_path, triangle(("ambient_red", "nx", "b")))) == 0


def test_what_is_no_header_stays_as_it_is():
    for data in (b"", b"no ply", b"ply\nformat ascii 1.0\n", b"ply\nformat ascii 1.0\nwhat\nend_header\n"):
        assert plain_ply(data) == (data, [])


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_and_the_picture_in_a_comment(tmp_path, names):
    Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / "my wood.png")
    lines = ["ply", "format ascii 1.0", "comment TextureFile my wood.png", "comment TextureFile second.png"]
    lines += ["element vertex 3", *(f"property float {name}" for name in ("x", "y", "z", *names))]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    lines += ["0 0 0 0 0", "1 0 0 0.5 0", "0 1 0 0 0.25", "3 0 1 2", ""]
    (tmp_path / "a.ply").write_text("\n".join(lines))
    (part,) = read_with_trimesh(tmp_path / "a.ply", textures := TextureStore())
    assert part.texture == 0 and not textures.unreadable and textures.ignored == ["TextureFile second.png"]
    uv = {tuple(place): corner for place, corner in zip(part.vertices.tolist(), part.uv.tolist())}
    assert [uv[place] for place in ((0, 0, 0), (1, 0, 0), (0, 1, 0))] == [[0, 1], [0.5, 1], [0, 0.75]]
