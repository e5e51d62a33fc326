from __future__ import annotations

import base64
import io
import json
from typing import Any

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.loaders.gltf import read_gltf
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore, assemble, srgb_from_linear
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

TRIANGLE = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], dtype=np.float32)
FACE = np.array([[0, 1, 2]])
UV = np.array([[0, 0], [1, 0], [0, 1]], dtype=np.float32)

# What a message to a user never holds.
PYTHON_WORDS = ("Error", "NoneType", "object is not", "list index", "unpack", "'int'", "'list'", "dtype", "buffer is")


def _png(color=(200, 100, 50), size=(4, 4)) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", size, color).save(stream, "PNG")
    return stream.getvalue()


def test_trimesh_reads_the_same_geometry_and_colours(tmp_path, rng):
    """Oracle: a scene of rotated, scaled instances with a texture, written by trimesh and read by both."""
    import trimesh

    scene = trimesh.Scene()
    textured = trimesh.creation.box((1, 2, 3))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (8, 8), (90, 60, 30)))
    textured.visual = trimesh.visual.TextureVisuals(uv=rng.random((8, 2)), material=material)
    colored = trimesh.creation.icosphere(subdivisions=1)
    colored.visual.vertex_colors = rng.integers(0, 255, (len(colored.vertices), 4), dtype=np.uint8)
    scene.add_geometry(textured, transform=trimesh.transformations.random_rotation_matrix(rng.random(3)))
    for shift in (2.0, 5.0):
        matrix = trimesh.transformations.scale_and_translate(1.5, (shift, 0, 1))
        scene.add_geometry(colored, node_name=f"ball{shift}", geom_name="ball", transform=matrix)
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))

    parts = read_gltf(path, textures := TextureStore()).parts
    expected = trimesh.load_scene(path, process=False)
    assert len(parts) == 3 and len(textures.images) == 1

    def soup(arrays):
        corners = np.round(np.concatenate(arrays).reshape(-1, 9), 4)
        return corners[np.lexsort(corners.T)]

    ours = soup([part.vertices[part.faces] for part in parts])
    theirs = soup([mesh.triangles for mesh in expected.dump(concatenate=False)])
    np.testing.assert_allclose(ours, theirs, atol=2e-4)
    ball = next(part for part in parts if part.texture < 0)
    np.testing.assert_allclose(ball.colors, colored.visual.vertex_colors[:, :3] / 255.0, atol=1e-6)


def test_factors_are_linear_and_multiply_vertex_colours_and_textures(tmp_path, gltf):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE, material=0)
    colors = np.array([[255, 255, 255, 255], [128, 128, 128, 255], [0, 0, 0, 255]], np.uint8)
    primitive["attributes"]["COLOR_0"] = gltf.accessor(colors, normalized=True)
    primitive["attributes"]["TEXCOORD_0"] = gltf.accessor(UV)
    gltf.header["images"] = [{"bufferView": gltf.view(_png()), "mimeType": "image/png"}]
    gltf.header["textures"] = [{"source": 0}]
    pbr = {"baseColorFactor": [0.21404, 1.0, 1.0, 1.0], "baseColorTexture": {"index": 0}}
    gltf.header["materials"] = [{"pbrMetallicRoughness": pbr}]
    (part,) = read_gltf(gltf.write(tmp_path / "a.glb"), textures := TextureStore()).parts
    assert part.texture == 0 and tuple(textures.images[0][0, 0]) == (200, 100, 50)
    # By hand: 0.21404 linear is 0.5 in sRGB; 128 / 255 = 0.502 linear is 0.7366, and 0.502 * 0.214 is 0.3615.
    expected = [[0.5, 1, 1], [0.3615, 0.7366, 0.7366], [0, 0, 0]]
    np.testing.assert_allclose(srgb_from_linear(part.colors), expected, atol=2e-4)
    assert part.linear  # and are interpolated so
    np.testing.assert_array_equal(part.uv, UV)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_colours_of_whole_numbers_are_shares_though_it_is_not_said(tmp_path, gltf, kind):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE)
    shares = np.tile([0.5, 0.25, 0.125, 1.0], (3, 1))
    primitive["attributes"]["COLOR_0"] = gltf.accessor((shares * np.iinfo(kind).max).astype(kind))
    (part,) = read_gltf(gltf.write(tmp_path / "a.glb"), TextureStore()).parts
    np.testing.assert_allclose(part.colors, shares[:, :3], atol=1 / 255)


def test_quantised_positions_and_uv_are_normalised(tmp_path, gltf):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE, material=0)
    quantised = np.array([[0, 0, 0, 0], [32767, 0, 0, 0], [0, -32767, 0, 0]], np.int16)
    view = gltf.view(quantised.tobytes(), byteStride=8)
    gltf.header["accessors"].append(
        {"bufferView": view, "componentType": 5122, "count": 3, "type": "VEC3", "normalized": True}
    )
    primitive["attributes"]["POSITION"] = len(gltf.header["accessors"]) - 1
    uv = np.array([[0, 0], [65535, 0], [0, 32768]], np.uint16)
    primitive["attributes"]["TEXCOORD_0"] = gltf.accessor(uv, normalized=True)
    gltf.header["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(_png()).decode()}]
    gltf.header["textures"] = [{"source": 0}]
    gltf.header["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    gltf.header["nodes"] = [{"mesh": 0, "scale": [4, 4, 4], "translation": [1, 0, 0]}]
    gltf.header["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_materials_unlit"]
    (part,) = read_gltf(gltf.write(tmp_path / "q.glb"), TextureStore()).parts
    np.testing.assert_allclose(part.vertices, [[1, 0, 0], [5, 0, 0], [1, -4, 0]], atol=1e-6)
    np.testing.assert_allclose(part.uv, [[0, 0], [1, 0], [0, 0.5]], atol=1e-4)


def test_sparse_accessors_replace_single_vertices(tmp_path, gltf):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE)
    accessor = gltf.header["accessors"][primitive["attributes"]["POSITION"]]
    accessor["sparse"] = {
        "count": 1,
        "indices": {"bufferView": gltf.view(np.array([2], np.uint16).tobytes()), "componentType": 5123},
        "values": {"bufferView": gltf.view(np.array([7, 8, 9], np.float32).tobytes())},
    }
    (part,) = read_gltf(gltf.write(tmp_path / "s.glb"), TextureStore()).parts
    np.testing.assert_array_equal(part.vertices, [[0, 0, 0], [2, 0, 0], [7, 8, 9]])


def test_texture_transform_as_in_the_extension_s_own_example(tmp_path, gltf):
    """Offset (0, 1), rotation 90 deg, scale 1/2 shows the lower left quadrant: u in [0, .5], v in [.5, 1]."""
    primitive = gltf.triangle_mesh(TRIANGLE, FACE, material=0)
    primitive["attributes"]["TEXCOORD_0"] = gltf.accessor(np.full((3, 2), 9, np.float32))
    primitive["attributes"]["TEXCOORD_1"] = gltf.accessor(UV)
    gltf.header["images"] = [{"bufferView": gltf.view(_png())}]
    gltf.header["textures"] = [{"source": 0}]
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5], "texCoord": 1}
    info = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    gltf.header["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": info}}]
    (part,) = read_gltf(gltf.write(tmp_path / "t.glb"), TextureStore()).parts
    # Image corners: top left -> (0, 1), top right -> (0, 0.5), bottom left -> (0.5, 1).
    np.testing.assert_allclose(part.uv, [[0, 1], [0, 0.5], [0.5, 1]], atol=1e-6)


def test_a_rotated_child_inside_a_matrix_parent(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE)
    quarter = [0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4)]  # x -> y about z
    parent = np.eye(4)
    parent[:3, 3] = (10, 0, 0)
    gltf.header["nodes"] = [
        {"children": [1], "matrix": parent.T.reshape(-1).tolist()},
        {"mesh": 0, "rotation": quarter, "scale": [2, 1, 1]},
        {"mesh": 0},  # in no scene: not shown
    ]
    gltf.header["scenes"] = [{"nodes": [0]}]
    (part,) = read_gltf(gltf.write(tmp_path / "n.glb"), TextureStore()).parts
    np.testing.assert_allclose(part.vertices, [[10, 0, 0], [10, 4, 0], [8, 0, 0]], atol=1e-6)


def test_nodes_in_a_loop_are_refused(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["nodes"] = [{"mesh": 0, "children": [1, 1]}, {"children": [0, 0]}]
    gltf.header["scenes"] = [{"nodes": [0]}]
    with pytest.raises(ValueError, match="loop"):
        read_gltf(gltf.write(tmp_path / "l.glb"), TextureStore())


@pytest.mark.parametrize("mode, expected", [(4, [[0, 1, 2]]), (5, [[0, 1, 2], [1, 2, 3]]), (6, [[0, 1, 2], [0, 2, 3]])])
def test_triangles_strips_and_fans(tmp_path, gltf, mode, expected):
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    primitive = gltf.triangle_mesh(corners, FACE, mode=mode)
    del primitive["indices"]
    if mode == 4:
        primitive["indices"] = gltf.accessor(np.array([0, 1, 2], np.uint8))
    (part,) = read_gltf(gltf.write(tmp_path / "m.glb"), TextureStore()).parts
    assert part.faces.tolist() == expected


def test_points_and_lines_are_passed_over(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE, mode=0)
    gltf.triangle_mesh(TRIANGLE, FACE, mode=1)
    assert read_gltf(gltf.write(tmp_path / "p.glb"), TextureStore()).parts == []


@pytest.mark.parametrize(
    "extension, reason",
    [
        ("EXT_meshopt_compression", "compressed with meshopt"),
        ("KHR_draco_mesh_compression", "compressed with Draco"),
        ("KHR_texture_basisu", "KTX2 / Basis"),
        ("MY_holograms", "the glTF extension MY_holograms"),
    ],
)
def test_what_cannot_be_decoded_is_refused_with_the_reason(tmp_path, gltf, extension, reason):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["extensionsRequired"] = ["KHR_mesh_quantization", extension]
    path = gltf.write(tmp_path / "c.glb")
    with pytest.raises(InputError, match=reason) as caught:
        read_gltf(path, TextureStore())
    assert extension in str(caught.value)
    assert ("npx @gltf-transform/cli copy " if "compressed" in reason else "convert it") in str(caught.value)


def test_the_command_that_unpacks_names_the_file(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["extensionsRequired"] = ["EXT_meshopt_compression", "KHR_draco_mesh_compression"]
    message = _error(gltf.write(tmp_path / "my flat.glb"))
    command = f"npx @gltf-transform/cli copy '{tmp_path}/my flat.glb' '{tmp_path}/my flat_uncompressed.glb'"
    assert message.endswith(f"export it without compression, or run: {command}")


def test_lower_levels_of_detail_are_not_shown(tmp_path, gltf):
    for shift in range(4):
        gltf.triangle_mesh(TRIANGLE + np.float32(shift), FACE)
    gltf.header["nodes"] = [
        {"mesh": 0, "extensions": {"MSFT_lod": {"ids": [1, 2]}}},
        {"mesh": 1},
        {"children": [3]},  # a lower level with a part of its own
        {"mesh": 3},
    ]
    gltf.header["extensionsRequired"] = ["MSFT_lod"]
    (part,) = read_gltf(gltf.write(tmp_path / "lod.glb"), TextureStore()).parts
    np.testing.assert_array_equal(part.vertices, TRIANGLE)


def test_gltf_finds_its_buffer_and_a_texture_above_its_folder(tmp_path, gltf):
    (tmp_path / "images").mkdir()
    (tmp_path / "models").mkdir()
    (tmp_path / "images" / "a b.png").write_bytes(_png())
    primitive = gltf.triangle_mesh(TRIANGLE, FACE, material=0)
    primitive["attributes"]["TEXCOORD_0"] = gltf.accessor(UV)
    gltf.header["images"] = [{"uri": "../images/a%20b.png"}, {"uri": "gone.png"}]
    gltf.header["textures"] = [{"source": 0}, {"source": 1}]
    gltf.header["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in (0, 1)]
    missing = gltf.triangle_mesh(TRIANGLE, FACE, material=1)
    missing["attributes"]["TEXCOORD_0"] = primitive["attributes"]["TEXCOORD_0"]
    parts = read_gltf(gltf.write(tmp_path / "models" / "room.gltf"), textures := TextureStore()).parts
    assert [part.texture for part in parts] == [0, -1]
    assert textures.unreadable == ["gone.png"]


def test_a_black_surface_that_shines_shows_its_emission(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE, material=0)["attributes"]["TEXCOORD_0"] = gltf.accessor(UV)
    gltf.header["images"] = [{"bufferView": gltf.view(_png())}]
    gltf.header["textures"] = [{"source": 0}]
    black = {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}}
    gltf.header["materials"] = [{**black, "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}]
    (part,) = read_gltf(gltf.write(tmp_path / "e.glb"), TextureStore()).parts
    assert part.texture == 0
    np.testing.assert_allclose(part.colors, 1.0)


def test_a_white_surface_that_shines_stays_white(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE, material=0)["attributes"]["TEXCOORD_0"] = gltf.accessor(UV)
    gltf.header["images"] = [{"bufferView": gltf.view(_png())}]
    gltf.header["textures"] = [{"source": 0}]
    gltf.header["materials"] = [{"emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}]
    (part,) = read_gltf(gltf.write(tmp_path / "e.glb"), TextureStore()).parts
    assert part.texture == -1
    np.testing.assert_allclose(part.colors, 1.0)


def test_samplers_say_how_a_texture_goes_on(tmp_path, gltf):
    uv = gltf.accessor(UV)
    for material in range(3):
        gltf.triangle_mesh(TRIANGLE, FACE, material=material)["attributes"]["TEXCOORD_0"] = uv
    gltf.header["images"] = [{"bufferView": gltf.view(_png())}]
    gltf.header["samplers"] = [{"wrapS": 33071, "wrapT": 33648}, {"magFilter": 9729}]
    gltf.header["textures"] = [{"source": 0, "sampler": 0}, {"source": 0, "sampler": 1}, {"source": 0}]
    gltf.header["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in range(3)]
    parts = read_gltf(gltf.write(tmp_path / "w.glb"), textures := TextureStore()).parts
    assert [part.wrap for part in parts] == [(CLAMP, MIRROR), (REPEAT, REPEAT), (REPEAT, REPEAT)]
    mesh = assemble(parts, textures.images)
    # One image, used in two ways: listed twice.
    assert mesh.face_texture.tolist() == [0, 1, 1] and mesh.texture_wrap == ((CLAMP, MIRROR), (REPEAT, REPEAT))
    assert mesh.textures[0] is mesh.textures[1]


def _error(path) -> str:
    """What the user reads."""
    with pytest.raises(InputError) as caught:
        load_mesh_scene(path)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"'{path}' ")
    return message


@pytest.mark.parametrize("asset", [{"version": "1.0"}, {}, {"version": "1.1"}])
def test_gltf_1_is_told_by_its_version(tmp_path, asset):
    path = tmp_path / "old.gltf"
    path.write_text(json.dumps({"asset": asset, "meshes": {"mesh": {"primitives": []}}, "nodes": {"node": {}}}))
    assert f"it is glTF {asset.get('version', '1.0')}, and only glTF 2.0 is read; convert it" in _error(path)


def test_compression_that_is_used_but_not_required(tmp_path, gltf):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE, extensions={"KHR_draco_mesh_compression": {"bufferView": 0}})
    gltf.header["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    assert len(read_gltf(gltf.write(tmp_path / "both.glb"), TextureStore()).parts) == 1  # a copy without compression
    for index in (primitive["attributes"]["POSITION"], primitive["indices"]):
        del gltf.header["accessors"][index]["bufferView"]
    message = _error(gltf.write(tmp_path / "draco.glb"))
    assert "compressed with Draco (KHR_draco_mesh_compression); export it without compression" in message


def test_meshopt_without_its_copy(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["bufferViews"][0].update(buffer=1, extensions={"EXT_meshopt_compression": {"buffer": 0}})
    path = gltf.write(tmp_path / "meshopt.gltf")
    header = json.loads(path.read_text())
    header["buffers"].append({"byteLength": 36, "extensions": {"EXT_meshopt_compression": {"fallback": True}}})
    path.write_text(json.dumps(header))
    assert "compressed with meshopt (EXT_meshopt_compression)" in _error(path)


def test_an_unknown_extension_is_to_be_left_out(tmp_path, gltf):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["extensionsRequired"] = ["MY_holograms"]
    message = _error(gltf.write(tmp_path / "h.glb"))
    assert "export it without MY_holograms, or convert it" in message and "compression" not in message


@pytest.mark.parametrize("name", ["COLOR_0", "TEXCOORD_0", "NORMAL"])
def test_arrays_of_different_lengths(tmp_path, gltf, name):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE)
    width = 2 if name == "TEXCOORD_0" else 3
    primitive["attributes"][name] = gltf.accessor(np.zeros((2, width), np.float32))
    assert f"have different lengths (POSITION 3, {name} 2)" in _error(gltf.write(tmp_path / "l.glb"))


@pytest.mark.parametrize(
    "place, value, said",
    [
        (("nodes", 0, "mesh"), 7, "number 7 of its meshes, and there are 1"),
        (("nodes", 0, "mesh"), -1, "number -1 of its meshes"),
        (("nodes", 0), [], "not what the format says"),
        (("meshes", 0), 5, "number 0 of its meshes is not an object"),
        (("scenes",), [{"nodes": [9]}], "number 9 of its nodes"),
        (("meshes", 0, "primitives", 0, "attributes", "POSITION"), 9, "number 9 of its accessors, and there are 2"),
        (("meshes", 0, "primitives", 0, "attributes", "POSITION"), None, "lacks 'POSITION'"),
        (("meshes", 0, "primitives", 0, "attributes"), None, "lacks 'attributes'"),
        (("meshes", 0, "primitives"), 3, "not what the format says"),
        (("meshes", 0, "primitives", 0, "material"), 0, "number 0 of its materials, and there are 0"),
        (("accessors", 0, "count"), None, "lacks 'count'"),
        (("accessors", 0, "count"), 400, "cut off"),
        (("accessors", 0, "type"), "VEC2", "its POSITION is VEC2 instead of VEC3"),
        (("accessors", 0, "type"), "VEC9", "its POSITION is VEC9"),
        (("accessors", 1, "componentType"), 1, "a componentType in it is 1, and glTF knows"),
        (("accessors", 0, "bufferView"), "a", "number a of its bufferViews"),
        (("bufferViews", 0, "buffer"), 1, "number 1 of its buffers"),
        (("buffers", 0, "uri"), "gone.bin", "its buffer file 'gone.bin' is missing"),
        (("buffers", 0, "uri"), None, "its buffer 0 has no data"),
        (("buffers", 0, "uri"), "data:,a", "damaged"),
        (("nodes", 0, "matrix"), [1, 2], "not what the format says"),
        (("nodes", 0, "rotation"), [1, 2], "not what the format says"),
        (("extensionsRequired",), 3, "extensionsRequired is not a list"),
    ],
)
def test_damage_is_said_in_words(tmp_path, gltf, place, value, said):
    gltf.triangle_mesh(TRIANGLE, FACE)
    path = gltf.write(tmp_path / "d.gltf")
    header = json.loads(path.read_text())
    holder: Any = header
    for key in place[:-1]:
        holder = holder[key]
    if value is None:
        del holder[place[-1]]
    else:
        holder[place[-1]] = value
    path.write_text(json.dumps(header))
    message = _error(path)
    assert said in message
    assert not any(word in message for word in PYTHON_WORDS)
