from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.mesh_loader import texture_notes
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore
from activestructure_gym.scenes.loaders.trimesh_reader import read_with_trimesh
from activestructure_gym.scenes.scene import CLAMP, REPEAT

OBJ = """mtllib ../materials/room.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl wood
f 1/1 2/2 3/3 4/4
usemtl red
f 1 2 4
"""
MTL = "newmtl wood\nKd 0 0 0\nmap_Kd ..\\images\\wood.png\nnewmtl red\nKd 0.8 0.2 0.4\n"


def test_obj_with_material_file_and_texture_outside_its_folder(tmp_path):
    for folder in ("models", "materials", "images"):
        (tmp_path / folder).mkdir()
    (tmp_path / "models" / "room.obj").write_text(OBJ)
    (tmp_path / "materials" / "room.mtl").write_text(MTL)
    Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / "images" / "wood.png")
    # The path in the .mtl is relative to the .obj, as trimesh and Blender read it.
    parts = read_with_trimesh(tmp_path / "models" / "room.obj", textures := TextureStore())
    wood = next(part for part in parts if part.texture >= 0)
    red = next(part for part in parts if part.texture < 0)
    assert not textures.unreadable and tuple(textures.images[0][0, 0]) == (120, 80, 40)
    assert len(wood.faces) == 2 and len(red.faces) == 1
    np.testing.assert_allclose(wood.colors, 1.0)  # not black, whatever Kd says beside a map
    np.testing.assert_allclose(red.colors, [0.8, 0.2, 0.4], atol=1 / 255)
    at_origin = np.flatnonzero((wood.vertices == 0).all(axis=1))[0]
    np.testing.assert_allclose(wood.uv[at_origin], [0, 1])  # v counts down from the top


def test_obj_and_materials_in_latin_1(tmp_path):
    (tmp_path / "room.obj").write_bytes(OBJ.replace("../materials/", "").replace("red", "grün").encode("latin-1"))
    (tmp_path / "room.mtl").write_bytes("newmtl grün\nKd 0.2 0.8 0.4\n".encode("latin-1"))
    parts = read_with_trimesh(tmp_path / "room.obj", textures := TextureStore())
    assert textures.unreadable == ["material wood"] and sum(len(part.faces) for part in parts) == 3
    green = next(part for part in parts if len(part.faces) == 1)
    np.testing.assert_allclose(green.colors, [0.2, 0.8, 0.4], atol=1 / 255)


def test_obj_says_which_files_are_missing(tmp_path):
    (tmp_path / "room.obj").write_text(OBJ)
    parts = read_with_trimesh(tmp_path / "room.obj", textures := TextureStore())
    assert sum(len(part.faces) for part in parts) == 3
    assert textures.unreadable == ["../materials/room.mtl"]


@pytest.mark.parametrize("element", ["vertex", "face"])
def test_ply_colours_of_vertices_and_of_faces(tmp_path, element):
    color_lines = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    of_vertex, of_face = (color_lines, "") if element == "vertex" else ("", color_lines)
    colors = [" 255 0 0", " 0 255 0", " 0 0 255"]
    vertices = ["0 0 0", "1 0 0", "0 1 0", "1 1 0"]
    header = (
        f"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{of_vertex}"
        f"element face 2\nproperty list uchar int vertex_indices\n{of_face}end_header\n"
    )
    if element == "vertex":
        rows = [v + c for v, c in zip(vertices, [*colors, " 255 255 255"])] + ["3 0 1 2", "3 1 3 2"]
    else:
        rows = [*vertices, "3 0 1 2" + colors[0], "3 1 3 2" + colors[1]]
    (tmp_path / "a.ply").write_text(header + "\n".join(rows) + "\n")
    (part,) = read_with_trimesh(tmp_path / "a.ply", TextureStore())
    corner_colors = part.colors[part.faces]  # [2, 3, 3]
    if element == "vertex":
        np.testing.assert_allclose(corner_colors[0], np.eye(3))
    else:
        np.testing.assert_allclose(corner_colors, [[[1, 0, 0]] * 3, [[0, 1, 0]] * 3])


def ply_of_colors(kind, rows):
    """A triangle with the given colours, as text."""
    lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {axis}" for axis in "xyz")]
    lines += [f"property {kind} {name}" for name in ("red", "green", "blue")]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{place} {color}" for place, color in zip(("0 0 0", "1 0 0", "0 1 0"), rows)]
    return "\n".join([*lines, "3 0 1 2", ""])


@pytest.mark.parametrize(
    ("kind", "rows", "expected"),
    [
        ("uchar", ["200 100 50", "0 0 1", "255 255 255"], [[200, 100, 50], [0, 0, 1], [255] * 3]),
        ("float", ["200 100 50", "0 0 1", "255 255 255"], [[200, 100, 50], [0, 0, 1], [255] * 3]),
        ("float", ["0.8 0.4 0.2", "0 0 1", "1.0001 1 1"], [[204, 102, 51], [0, 0, 255], [255] * 3]),
        ("float", ["3 0.4 0.2", "0 0 1", "0.6 0.6 0.6"], [[255, 102, 51], [0, 0, 255], [153] * 3]),  # baked light
        ("ushort", ["30000 25700 12850", "0 0 257", "65535 65535 65535"], [[117, 100, 50], [0, 0, 1], [255] * 3]),
        ("int", ["200 100 50", "0 0 1", "255 255 255"], [[200, 100, 50], [0, 0, 1], [255] * 3]),
    ],
)
def test_ply_colours_of_any_type_are_shares(tmp_path, kind, rows, expected):
    (tmp_path / "a.ply").write_text(ply_of_colors(kind, rows))
    (part,) = read_with_trimesh(tmp_path / "a.ply", TextureStore())
    np.testing.assert_allclose(part.colors, np.array(expected) / 255)


def test_a_colour_that_is_none_stays_for_the_loader_to_paint(tmp_path):
    (tmp_path / "a.ply").write_text(ply_of_colors("float", ["nan 0 0", "0 inf 0", "0.2 0.4 0.6"]))
    (part,) = read_with_trimesh(tmp_path / "a.ply", TextureStore())
    assert np.isnan(part.colors[:2]).all()
    np.testing.assert_allclose(part.colors[2], [0.2, 0.4, 0.6])


def test_obj_colours_up_to_255_are_shares_in_all_of_its_parts(tmp_path):
    lines = ["v 0 0 0 200 100 50", "v 1 0 0 255 255 255", "v 0 1 0 100 100 100", "f 1 2 3", "usemtl dark"]
    lines += ["v 5 0 0 1 0 0", "v 6 0 0 0 0 0", "v 5 1 0 0 1 1", "f 4 5 6"]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    colors = np.concatenate([part.colors for part in read_with_trimesh(tmp_path / "a.obj", TextureStore())])
    expected = [[200, 100, 50], [255] * 3, [100] * 3, [1, 0, 0], [0, 0, 0], [0, 1, 1]]
    assert sorted(map(tuple, np.rint(colors * 255).tolist())) == sorted(map(tuple, np.array(expected, float).tolist()))


@pytest.mark.parametrize(
    "named",
    ["mtllib a.mtl\nmtllib b b.mtl\n", "mtllib a.mtl b b.mtl\n", "mtllib a.mtl\nmtllib b b.mtl\nmtllib a.mtl\n"],
)
def test_materials_of_several_libraries(tmp_path, named):
    (tmp_path / "a.mtl").write_bytes(b"newmtl red\r\nKd 1 0 0\r\n")
    (tmp_path / "b b.mtl").write_text("newmtl blue\nKd 0 0 1")
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 3 2\n"
    (tmp_path / "a.obj").write_text(named + text)
    parts = read_with_trimesh(tmp_path / "a.obj", textures := TextureStore())
    assert sorted(part.colors.tolist() for part in parts) == [[0, 0, 1], [1, 0, 0]] and not textures.unreadable
    (tmp_path / "b b.mtl").unlink()
    read_with_trimesh(tmp_path / "a.obj", textures := TextureStore())
    assert textures.unreadable == ["b b.mtl", "material blue"]


def test_a_material_that_the_library_lacks_is_said(tmp_path):
    text = OBJ.replace("../materials/", "") + "usemtl None\nf 1 3 4\nusemtl stone\nf 2 3 4\n"
    (tmp_path / "room.obj").write_text(text)
    (tmp_path / "room.mtl").write_text(MTL.replace("map_Kd ..\\images\\wood.png\n", ""))
    read_with_trimesh(tmp_path / "room.obj", textures := TextureStore())
    assert textures.unreadable == ["material stone"]


DOORWAY = [(0, 0), (1, 0), (1, 2), (2, 2), (2, 0), (5, 0), (5, 3), (0, 3)]  # 13 m2; a fan over it has 19
ARROW = [(6, 0), (8, 1), (6, 2), (7, 1)]  # 1 m2, turns back at its last corner
SQUARE = [(9, 0), (10, 0), (10, 1), (9, 1)]


@pytest.mark.parametrize("outlines", [[DOORWAY], [ARROW], [ARROW, SQUARE], [SQUARE[:3], DOORWAY, SQUARE, ARROW]])
@pytest.mark.parametrize("uv", [False, True])
@pytest.mark.parametrize("colored", [False, True])
def test_concave_polygons_of_a_ply_stay_open(tmp_path, outlines, uv, colored):
    corners = [corner for outline in outlines for corner in outline]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(corners)}"]
    lines += [f"property float {name}" for name in ("x", "y", "z", *("st" if uv else ""))]
    lines += [f"element face {len(outlines)}", "property list uchar int vertex_indices"]
    lines += [f"property uchar {name}" for name in (("red", "green", "blue") if colored else ())]
    lines += ["end_header", *(f"{x} 1.5 {z}" + (f" {x} {z}" if uv else "") for x, z in corners)]
    start, expected = 0, []
    for k, outline in enumerate(outlines):
        indices = " ".join(map(str, range(start, start + len(outline))))
        lines.append(f"{len(outline)} {indices}" + (f" {k * 60} 0 0" if colored else ""))
        start += len(outline)
        x, z = np.array(outline, float).T
        expected.append(0.5 * abs((x * np.roll(z, -1) - np.roll(x, -1) * z).sum()))
    (tmp_path / "a.ply").write_text("\n".join(lines) + "\n")
    (part,) = read_with_trimesh(tmp_path / "a.ply", TextureStore())
    found = part.vertices[part.faces]
    area = 0.5 * np.linalg.norm(np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]), axis=1)
    assert area.sum() == pytest.approx(sum(expected))
    if colored and not uv:  # every polygon keeps its own colour
        face_color = np.round(part.colors[part.faces[:, 0], 0] * 255 / 60).astype(int)
        np.testing.assert_allclose(np.bincount(face_color, area, minlength=len(outlines)), expected)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_obj_in_other_encodings(tmp_path, encoding):
    (tmp_path / "a.obj").write_bytes(OBJ.encode(encoding))
    if encoding == "utf-16-le":  # without a mark
        with pytest.raises(UnreadableMesh, match="save it as UTF-8"):
            read_with_trimesh(tmp_path / "a.obj", TextureStore())
    else:
        assert sum(len(p.faces) for p in read_with_trimesh(tmp_path / "a.obj", TextureStore())) == 3


def test_texture_coordinates_that_do_not_exist_are_said(tmp_path):
    (tmp_path / "room.obj").write_text(OBJ.replace("../materials/", "").replace("3/3", "3/99"))
    (tmp_path / "room.mtl").write_text(MTL.replace("..\\images\\", ""))
    Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / "wood.png")
    parts = read_with_trimesh(tmp_path / "room.obj", textures := TextureStore())
    assert all(part.texture < 0 for part in parts) and textures.without_uv == ["wood"]


@pytest.mark.parametrize(
    ("statement", "at_origin", "at_far_corner", "wrap"),
    [
        ("map_Kd wood.png", [0, 1], [1, 0], REPEAT),
        ("map_Kd -s 2 4 1 wood.png", [0, 1], [2, -3], REPEAT),
        ("map_Kd -o 0.5 0.25 0 -s 2 4 wood.png # floor", [0.5, 0.75], [2.5, -3.25], REPEAT),
        ("\tMAP_KD\t-o\t.5 -clamp on  oak wood.PNG", [0.5, 1], [1.5, 0], CLAMP),
    ],
)
def test_options_of_a_map_move_the_texture(tmp_path, statement, at_origin, at_far_corner, wrap):
    (tmp_path / "room.obj").write_text(OBJ.replace("../materials/", ""))
    (tmp_path / "room.mtl").write_bytes(f"newmtl wood\r\n{statement}\r\nnewmtl red\r\n".encode())
    for name in ("wood.png", "oak wood.PNG"):
        Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / name)
    parts = read_with_trimesh(tmp_path / "room.obj", textures := TextureStore())
    wood = next(part for part in parts if part.texture >= 0)
    assert not textures.unreadable and not textures.ignored and wood.wrap == (wrap, wrap)
    corner = {tuple(place): uv for place, uv in zip(wood.vertices[:, :2].tolist(), wood.uv.tolist())}
    np.testing.assert_allclose(corner[0, 0], at_origin)  # v counts down from the picture's top
    np.testing.assert_allclose(corner[1, 1], at_far_corner)


def test_an_option_that_is_not_read_is_said(tmp_path):
    (tmp_path / "room.obj").write_text(OBJ.replace("../materials/", ""))
    (tmp_path / "room.mtl").write_text("newmtl wood\nmap_Kd -t 1 1 1 wood.png\nnewmtl red\n")
    Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / "wood.png")
    read_with_trimesh(tmp_path / "room.obj", textures := TextureStore())
    assert textures.ignored == ["-t 1 1 1 of wood.png"]
    assert texture_notes(textures) == ["texture settings that are not supported were ignored (-t 1 1 1 of wood.png)"]


def test_a_binary_ply_of_triangles_and_quads_is_told_what_to_do(tmp_path):
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    data = np.zeros((4, 3), "<f4").tobytes() + b"\3" + np.arange(3, dtype="<i4").tobytes()
    (tmp_path / "a.ply").write_bytes(header.encode() + data + b"\4" + np.arange(4, dtype="<i4").tobytes())
    with pytest.raises(UnreadableMesh, match="differ in their number of corners: triangulate it"):
        read_with_trimesh(tmp_path / "a.ply", TextureStore())
