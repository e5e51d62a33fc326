from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene

DAE = """<COLLADA><asset><unit meter="{meter}"/><up_axis>{up}_UP</up_axis></asset>
<library_geometries><geometry><mesh>
<source id="p"><float_array>{positions}</float_array>
<technique_common><accessor stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles>
</mesh></geometry></library_geometries></COLLADA>"""


@pytest.fixture
def write_box(tmp_path, make_box):
    """Writes a box of 4 x 3 x 2.5 (times a factor) in the format of the suffix, and returns the path.

    glTF has y up, as its standard says.
    """
    import trimesh

    def write(suffix: str, factor: float = 1.0):
        path = tmp_path / f"room{suffix}"
        vertices, faces = make_box((0, 0, 0), np.array([4, 3, 2.5]) * factor)
        if suffix in (".glb", ".gltf"):
            vertices = vertices[:, [0, 2, 1]] * (1, 1, -1)
        if suffix == ".dae":
            numbers = (" ".join(map(str, array.reshape(-1))) for array in (vertices, faces))
            path.write_text(DAE.format(meter=1, up="Z", positions=next(numbers), faces=next(numbers)))
        elif suffix == ".gltf":
            for name, data in trimesh.Scene(trimesh.Trimesh(vertices, faces)).export(file_type="gltf").items():
                (path if name.endswith(".gltf") else tmp_path / name).write_bytes(data)
        else:
            trimesh.Trimesh(vertices, faces, process=False).export(path)
        return path

    return write


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".ply", ".stl", ".dae"])
def test_every_format_gives_the_same_room(write_box, suffix):
    scene = load_mesh_scene(write_box(suffix))
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [4, 3, 2.5]], atol=1e-6)
    assert len(scene.mesh.faces) == 12 and scene.name == "room" and scene.source.endswith(suffix)
    assert scene.notes[0] == "4.00 x 3.00 x 2.50 m (x, y, z), ceiling height 2.50 m: plausible"
    # What the user has to know to trust a picture of it: an empty box does not tell its floor from its ceiling.
    up = "y" if suffix in (".glb", ".gltf") else "z"
    assert any(note.startswith(f"{up} is up") for note in scene.notes)
    assert not any("is up" in note for note in load_mesh_scene(scene.source, up=up).notes)
    assert any("one colour only" in note for note in scene.notes)
    mesh = scene.mesh
    assert (mesh.vertices.dtype, mesh.faces.dtype, mesh.colors.dtype) == (np.float32, np.int32, np.float32)
    assert len(mesh.colors) == len(mesh.uv) == len(mesh.vertices) and len(mesh.face_texture) == len(mesh.faces)


@pytest.mark.parametrize("units, factor", [("mm", 1000.0), ("cm", 100.0), ("ft", 1 / 0.3048), (0.5, 2.0), ("0.5", 2.0)])
def test_units_bring_the_room_back_to_metres(write_box, units, factor):
    scene = load_mesh_scene(write_box(".ply", factor), units=units)
    np.testing.assert_allclose(scene.bounds[1], [4, 3, 2.5], rtol=1e-6)


@pytest.mark.parametrize(
    "up, expected",
    [("z", [4, 3, 2.5]), ("-z", [4, 3, 2.5]), ("y", [4, 2.5, 3]), ("-y", [4, 2.5, 3]), ("x", [2.5, 3, 4]),
     ("-x", [2.5, 3, 4])],
)  # fmt: skip
def test_up_axes_turn_the_room_without_mirroring_it(write_box, up, expected):
    path = write_box(".ply")
    scene = load_mesh_scene(path, up=up)
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], expected, atol=1e-6)
    before = load_mesh_scene(path).mesh.vertices.astype(float)
    after = scene.mesh.vertices.astype(float)
    rotation = np.linalg.lstsq(before - before.mean(axis=0), after - after.mean(axis=0), rcond=None)[0].T
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    # What pointed up in the file points up in the world.
    file_up = {"x": 0, "y": 1, "z": 2}[up[-1]]
    assert rotation[2, file_up] == pytest.approx(-1.0 if up[0] == "-" else 1.0)


def test_collada_declares_its_unit_and_axis_and_options_win_over_them(write_box, tmp_path):
    path = write_box(".dae")
    text = path.read_text().replace('meter="1"', 'meter="0.5"').replace("Z_UP", "Y_UP")
    path.write_text(text)
    np.testing.assert_allclose(np.ptp(load_mesh_scene(path).bounds, axis=0), [2, 1.25, 1.5])
    np.testing.assert_allclose(np.ptp(load_mesh_scene(path, units="m", up="z").bounds, axis=0), [4, 3, 2.5])


def test_textures_are_shared_and_shrunk(tmp_path, make_box, rng):
    import trimesh

    scene = trimesh.Scene()
    for k in range(3):
        image = Image.fromarray(np.full((600, 300, 3), (40, 90, 30 if k < 2 else 200), np.uint8))
        box = trimesh.Trimesh(*make_box((0, 0, k), (4, 3, k + 1)), process=False)
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
        box.visual = trimesh.visual.TextureVisuals(uv=rng.random((8, 2)), material=material)
        scene.add_geometry(box)
    (tmp_path / "t.glb").write_bytes(scene.export(file_type="glb"))
    mesh = load_mesh_scene(tmp_path / "t.glb", max_texture=100).mesh
    assert [texture.shape for texture in mesh.textures] == [(100, 50, 3), (100, 50, 3)]
    assert np.unique(mesh.face_texture, return_counts=True)[1].tolist() == [24, 12]


def _error(path, **options) -> str:
    with pytest.raises(InputError) as caught:
        load_mesh_scene(path, **options)
    message = str(caught.value)
    assert "\n" not in message and str(path) in message
    return message


def test_missing_file_folder_and_unknown_suffix(tmp_path):
    assert "there is no mesh file" in _error(tmp_path / "gone.glb")
    assert "is a folder" in _error(tmp_path)
    (tmp_path / "room.fbx").write_bytes(b"x")
    assert "it reads .glb, .gltf, .obj, .ply, .stl, .dae" in _error(tmp_path / "room.fbx")


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".ply", ".stl", ".dae"])
@pytest.mark.parametrize("content", [b"", b"this is not a mesh", bytes(range(256)) * 8])
def test_corrupt_files_of_every_format(tmp_path, suffix, content):
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    message = _error(path)
    assert "cannot be read" in message or "no triangles" in message


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".dae", ".stl"])
def test_a_file_that_is_cut_off(write_box, suffix):
    path = write_box(suffix)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    message = _error(path)
    assert "cannot be read" in message and "module" not in message  # no package would help


def test_a_binary_file_called_obj_is_no_missing_package(write_box):
    odd = write_box(".glb").rename(write_box(".obj"))
    assert "not OBJ text" in _error(odd)


def test_empty_mesh_and_mesh_without_area(tmp_path, gltf):
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 4 0 0\nv 0 3 2\n")
    assert "no triangles" in _error(tmp_path / "points.obj")
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 4 0 0\nv 2 0 0\nf 1 2 3\n")
    assert "no triangles with an area" in _error(tmp_path / "line.obj")
    assert "no triangles" in _error(gltf.write(tmp_path / "empty.glb"))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".stl"])
def test_vertices_that_are_not_finite(tmp_path, gltf, make_box, suffix, bad):
    import trimesh

    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    vertices[:2, 1] = bad
    path = tmp_path / f"nan{suffix}"
    if suffix == ".glb":
        gltf.triangle_mesh(vertices, faces)
        gltf.write(path)
    else:
        with np.errstate(invalid="ignore"):  # STL wants normals
            trimesh.Trimesh(vertices, faces, process=False).export(path)
    assert re.search(r"has \d+ of \d+ vertices that are not finite", _error(path))


def test_triangles_that_name_missing_vertices(tmp_path, gltf, make_box):
    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    gltf.triangle_mesh(vertices, faces + 3)
    assert "vertices that do not exist" in _error(gltf.write(tmp_path / "index.glb"))


def test_a_room_in_millimetres_is_told_its_unit(write_box):
    message = _error(write_box(".stl", 1000.0))
    assert "4000 x 3000 x 2500 m" in message and "units=mm" in message
    # The other way round: metres read as millimetres. The hint is about the file, not about what came of it.
    message = _error(write_box(".stl"), units="mm")
    assert "0.004 x 0.003 x 0.0025 m" in message and message.endswith("try units=m (4.0 x 3.0 x 2.5 m)")


def test_units_are_proposed_with_the_size_they_give_the_likeliest_first(tmp_path, make_box):
    import trimesh

    vertices, faces = make_box((0, 0, 0), (283, 161, 106))  # a hotel room in inches
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "room.stl")
    sizes = "units=in (7.2 x 4.1 x 2.7 m) or units=cm (2.8 x 1.6 x 1.1 m) or units=dm (28.3 x 16.1 x 10.6 m)"
    assert _error(tmp_path / "room.stl").endswith(f"no room or building: try {sizes}")


def test_unknown_units_and_axes(write_box):
    path = write_box(".stl")
    with pytest.raises(InputError, match="unknown unit 'inch'; did you mean 'in'"):
        load_mesh_scene(path, units="inch")
    for units in (-1.0, 0, "nan", "inf", "1e300", 1e-300):
        with pytest.raises(InputError, match="above 0"):
            load_mesh_scene(path, units=units)
    with pytest.raises(InputError, match="unknown up axis 'w'"):
        load_mesh_scene(path, up="w")


@pytest.mark.parametrize(
    "factor, said", [(1 / 0.3048, "try units=ft (4.0 x 3.0 x 2.5 m)"), (10.0, "units=dm"), (0.3, "units=")]
)
def test_the_scale_check_names_units_that_make_a_room(write_box, factor, said):
    note = load_mesh_scene(write_box(".stl", factor)).notes[0]
    assert "unusual" in note and said in note


def test_a_scene_on_its_side_is_refused(tmp_path, make_box):
    import trimesh

    trimesh.Trimesh(*make_box((0, 0, 0), (6, 2.5, 5)), process=False).export(tmp_path / "side.stl")
    message = _error(tmp_path / "side.stl")
    assert "z is up for STL files, which do not say, but the geometry says y or -y" in message
    assert message.endswith("give up=y or up=-y to follow the geometry, or up=z to insist")
    assert "plausible" in load_mesh_scene(tmp_path / "side.stl", up="y").notes[0]
    with pytest.warns(InputWarning, match="up=z, though the geometry says y or -y"):
        load_mesh_scene(tmp_path / "side.stl", up="z")


@pytest.mark.parametrize("size", [(30.0, 1.6, 2.5), (1.2, 1.2, 2.4)])
def test_a_corridor_and_a_closet_stand_upright(tmp_path, make_box, size):
    import trimesh

    trimesh.Trimesh(*make_box((0, 0, 0), size), process=False).export(tmp_path / "narrow.stl")
    assert "plausible" in load_mesh_scene(tmp_path / "narrow.stl").notes[0]


def test_a_vertex_that_no_triangle_uses_does_not_count(tmp_path, make_box):
    import trimesh

    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    vertices, colors = np.vstack([[[500, 500, 500]], vertices]), np.arange(9 * 3).reshape(9, 3)
    trimesh.Trimesh(vertices, faces + 1, vertex_colors=colors, process=False).export(tmp_path / "stray.ply")
    scene = load_mesh_scene(tmp_path / "stray.ply")
    np.testing.assert_allclose(scene.bounds, [[0, 0, 0], [4, 3, 2.5]])
    corners = scene.mesh.faces.reshape(-1)
    np.testing.assert_allclose(scene.mesh.vertices[corners], vertices[1:][faces.reshape(-1)])
    np.testing.assert_allclose(scene.mesh.colors[corners] * 255, colors[1:][faces.reshape(-1)], atol=1e-4)


def test_a_mesh_in_survey_coordinates_is_told_of_its_steps(tmp_path, make_box):
    import trimesh

    for offset, said in ((9e4, True), (900.0, False)):
        vertices, faces = make_box((offset, 0, 0), (offset + 4, 3, 2.5))
        trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "far.ply")
        notes = load_mesh_scene(tmp_path / "far.ply").notes
        assert any("steps of 8 mm: move it to the origin" in note for note in notes) == said


def test_max_texture_is_a_size(write_box):
    with pytest.raises(InputError, match="at least 1, got 0"):
        load_mesh_scene(write_box(".stl"), max_texture=0)


@pytest.mark.parametrize("name", ["bookstore", "garage", "home_theater", "hotel_room"])
def test_real_scenes_agree_with_trimesh(shared, name):
    import trimesh

    path = shared / "scenes" / f"{name}.glb"
    scene = load_mesh_scene(path, up="z")
    expected = trimesh.load_scene(path, process=False)
    np.testing.assert_allclose(scene.bounds, expected.bounds, atol=1e-5)
    corners = scene.mesh.vertices.astype(float)[scene.mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    assert area == pytest.approx(expected.area, rel=1e-5)
    assert "plausible" in scene.notes[0]
    assert max((max(texture.shape) for texture in scene.mesh.textures), default=0) <= 512


@pytest.mark.parametrize("name", ["a\nb.ply", "red\x1b[31m.ply", "half\udcff.ply"])
def test_names_that_fail_in_pictures_are_refused_before(write_box, tmp_path, name):
    write_box(".ply").rename(tmp_path / name)
    with pytest.raises(InputError, match="cannot be printed"):
        load_mesh_scene(tmp_path / name)


def test_a_scene_s_name_is_one_line(write_box):
    with pytest.raises(InputError, match=r"the name 'a.nb' has characters that cannot be printed"):
        load_mesh_scene(write_box(".ply"), name="a\nb")


def test_triangles_that_lie_over_each_other(tmp_path, gltf, make_box):
    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    gltf.triangle_mesh(vertices, np.tile(faces, (500, 1)))
    assert "a line through it meets about 2,000 triangle boxes" in _error(gltf.write(tmp_path / "x.glb"), up="z")


def test_colours_that_are_no_numbers_become_grey(tmp_path, gltf, make_box):
    vertices, faces = make_box((0, 0, 0), (4, 3, 2.5))
    colors = np.full((8, 3), 0.5, np.float32)
    colors[3] = np.nan
    gltf.triangle_mesh(vertices, faces)["attributes"]["COLOR_0"] = gltf.accessor(colors)
    scene = load_mesh_scene(gltf.write(tmp_path / "x.glb"), up="z")
    assert np.isfinite(scene.mesh.colors).all() and any("1 vertices have colours" in note for note in scene.notes)


def test_vertices_beyond_float32_are_not_finite_either(write_box):
    path = write_box(".obj")
    path.write_text(path.read_text().replace("v ", "v 1e200 0 0\nv ", 1))
    assert "1 of 8 vertices that are not finite" in _error(path)
