from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore
from activestructure_gym.scenes.loaders.obj_text import plain_obj
from activestructure_gym.scenes.loaders.trimesh_reader import read_with_trimesh


def square(side, z, corner="{}"):
    """Four vertices of a square, and the corners -4 ... -1 in the given form."""
    places = ((0, 0), (side, 0), (side, side), (0, side))
    vertices = "".join(f"v {x} {y} {z}\n" for x, y in places)
    return vertices, "f " + " ".join(corner.format(k) for k in (-4, -3, -2, -1)) + "\n"


def area_of(path, text):
    path.write_text(text)
    corners = np.concatenate([p.vertices[p.faces] for p in read_with_trimesh(path, TextureStore())])
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()


@pytest.mark.parametrize("corner", ["{}", "{}/{}", "{}//{}", "{}/{}/{}"])
@pytest.mark.parametrize("group", ["", "g wall\nusemtl plaster\ns 1\n"])
def test_relative_indices_count_from_their_own_line(tmp_path, corner, group):
    """Two squares of 1 and 4 m2, each after its own four vertices: counted from the end, both would be the second."""
    corner = corner.replace("{}", "{0}")
    properties = "".join(f"vt {k}.5 0.5\nvn 0 0 1\n" for k in range(4))
    text = ""
    for side, z in ((1, 0), (2, 1)):
        vertices, face = square(side, z, corner)
        text += vertices + properties + group + face
    assert area_of(tmp_path / "a.obj", text) == pytest.approx(5.0)


def test_lines_that_go_on_blanks_tabs_and_comments(tmp_path):
    vertices, face = square(2, 0)
    text = "  " + vertices.replace("\n", "\n\t") + face.replace(" -2", " \\\r\n  -2").replace("\n", "  # -9\n", 2)
    text = text.replace("\\\r  # -9\n", "\\\r\n").replace("f ", "f\t")
    assert area_of(tmp_path / "a.obj", text) == pytest.approx(4.0)


@pytest.mark.parametrize("face", ["f 1 2 3 4", "f -4 -3 -2 -1"])
def test_a_comment_behind_numbers_is_none_of_them(tmp_path, face):
    text = square(2, 0)[0].replace(" 0\n", " 0 # 1 2 3\n", 1) + f"# f 9 9 9\ng a#1\n{face} # wall 7\nf 1 2 3# 4\n"
    assert area_of(tmp_path / "a.obj", text) == pytest.approx(6.0)
    assert "# f 9 9 9\ng a#1\n" in plain_obj(text)


def test_lines_that_end_as_on_old_computers(tmp_path):
    (tmp_path / "a.obj").write_bytes((square(2, 0)[0] + "f 1 2 3 4\n").replace("\n", "\r").encode())
    (part,) = read_with_trimesh(tmp_path / "a.obj", TextureStore())
    assert len(part.faces) == 2


def test_counting_back_beyond_the_first_vertex_is_refused():
    with pytest.raises(UnreadableMesh, match="refers 5 entries back, but only 4 precede"):
        plain_obj(square(1, 0)[0] + "f -5 -3 -2 -1\n")


DOORWAY = ((0, 0), (1, 0), (1, 2), (2, 2), (2, 0), (5, 0), (5, 3), (0, 3))


@pytest.mark.parametrize("corner", ["{0}", "{0}/{0}", "-{1}/-{1}"])
def test_a_doorway_stays_open(tmp_path, corner):
    text = "".join(f"v {x} 0 {z}\nvt {x} {z}\n" for x, z in DOORWAY)
    text += "f " + " ".join(corner.format(k, 9 - k) for k in range(1, 9)) + "\n"
    assert area_of(tmp_path / "wall.obj", text) == pytest.approx(13.0)


def test_a_file_of_triangles_and_convex_polygons_is_left_alone():
    text = square(1, 0)[0] + "vn 0 0 -1\nf 1//1 2//1 3//1\nf 1 2 3 4\n"
    assert plain_obj(text) == text
