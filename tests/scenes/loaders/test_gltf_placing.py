"""Where a glTF file puts its meshes: every number here is worked out by hand from the specification."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.scenes.loaders.gltf import read_gltf
from activestructure_gym.scenes.loaders.mesh_loader import load_mesh_scene
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore

TRIANGLE = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], dtype=np.float32)
FACE = np.array([[0, 1, 2]])
HALF_TURN_Y = [0.0, 1.0, 0.0, 0.0]  # x, y, z, w
QUARTER_TURN_Z = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]  # x to y


@pytest.fixture
def parts(tmp_path, gltf):
    """Writes what the test has put together, and reads it."""
    return lambda: read_gltf(gltf.write(tmp_path / "a.glb"), TextureStore()).parts


def _hidden(node: dict, visible: bool = False) -> dict:
    return {**node, "extensions": {"KHR_node_visibility": {"visible": visible}}}


def test_a_hidden_node_hides_all_below_it(gltf, parts):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["nodes"] = [
        _hidden({"children": [1, 2]}),
        _hidden({"mesh": 0}, visible=True),  # its parent is hidden, so it is
        {"children": [3]},
        {"mesh": 0},
        _hidden({"mesh": 0, "translation": [5, 0, 0]}, visible=True),
        {"mesh": 0, "extensions": {"KHR_node_visibility": {}}, "translation": [9, 0, 0]},  # visible unless it says so
    ]
    gltf.header["scenes"] = [{"nodes": [0, 4, 5]}]
    gltf.header["extensionsRequired"] = gltf.header["extensionsUsed"] = ["KHR_node_visibility"]
    assert [part.vertices[0, 0] for part in parts()] == [5, 9]


def _instanced(gltf, **arrays):
    gltf.triangle_mesh(TRIANGLE, FACE)
    extension = {"EXT_mesh_gpu_instancing": {"attributes": arrays}}
    gltf.header["nodes"] = [{"mesh": 0, "translation": [10, 0, 0], "scale": [2, 2, 2], "extensions": extension}]


@pytest.mark.parametrize("required", [False, True])
def test_instances_stand_behind_the_transform_of_their_node(gltf, parts, required):
    _instanced(
        gltf,
        TRANSLATION=gltf.accessor(np.array([[0, 0, 0], [1, 2, 3]], np.float32)),
        ROTATION=gltf.accessor(np.array([[0, 0, 0, 1], QUARTER_TURN_Z], np.float32)),
        SCALE=gltf.accessor(np.array([[1, 1, 1], [1, 3, 1]], np.float32)),
        _ID=gltf.accessor(np.array([4, 7], np.uint16)),
    )
    gltf.header["extensionsRequired" if required else "extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    first, second = parts()
    np.testing.assert_allclose(first.vertices, [[10, 0, 0], [14, 0, 0], [10, 4, 0]], atol=1e-6)
    # (2, 0, 0) is scaled to (2, 0, 0), turned to (0, 2, 0), moved to (1, 4, 3), then doubled and moved by the node.
    # (0, 2, 0) is scaled to (0, 6, 0), turned to (-6, 0, 0), moved to (-5, 2, 3).
    np.testing.assert_allclose(second.vertices, [[12, 4, 6], [12, 8, 6], [0, 4, 6]], atol=1e-5)


@pytest.mark.parametrize("kind", [np.int8, np.int16])
def test_turns_of_instances_may_be_whole_numbers(gltf, parts, kind):
    most = np.iinfo(kind).max
    turns = np.rint(np.array([QUARTER_TURN_Z, HALF_TURN_Y]) * most).astype(kind)
    _instanced(gltf, ROTATION=gltf.accessor(turns, normalized=True))
    quarter, half = parts()
    np.testing.assert_allclose(quarter.vertices, [[10, 0, 0], [10, 4, 0], [6, 0, 0]], atol=1e-5)
    np.testing.assert_allclose(half.vertices, [[10, 0, 0], [6, 0, 0], [10, 4, 0]], atol=1e-5)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"TRANSLATION": np.zeros((2, 3), np.float32), "SCALE": np.ones((3, 3), np.float32)}, "TRANSLATION 2, SCALE 3"),
        ({"ROTATION": np.zeros((2, 3), np.float32)}, "ROTATION of its instances has 3 numbers and not 4"),
    ],
)
def test_arrays_of_instances_that_do_not_fit_are_said(tmp_path, gltf, arrays, said):
    _instanced(gltf, **{name: gltf.accessor(values) for name, values in arrays.items()})
    with pytest.raises(InputError, match=said):
        load_mesh_scene(gltf.write(tmp_path / "a.glb"))


def _skinned(gltf, joints, weights, inverse=None, sets=1):
    """The triangle on two joints: one at (100, 0, 0), the other 1 m above it, turned by a quarter from x to y."""
    primitive = gltf.triangle_mesh(TRIANGLE, FACE)
    for k in range(sets):
        primitive["attributes"][f"JOINTS_{k}"] = gltf.accessor(np.asarray(joints, np.uint8)[:, 4 * k : 4 * k + 4])
        columns = np.asarray(weights)[:, 4 * k : 4 * k + 4]
        whole = columns.dtype.kind == "u"
        primitive["attributes"][f"WEIGHTS_{k}"] = gltf.accessor(
            columns if whole else columns.astype(np.float32), **({"normalized": True} if whole else {})
        )
    gltf.header["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [7, 7, 7], "scale": [9, 9, 9]},  # does not count
        {"translation": [100, 0, 0], "children": [2]},
        {"translation": [0, 1, 0], "rotation": QUARTER_TURN_Z},
    ]
    gltf.header["scenes"] = [{"nodes": [0, 1]}]
    gltf.header["skins"] = [{"joints": [1, 2]}]
    if inverse is not None:
        gltf.header["skins"][0]["inverseBindMatrices"] = len(gltf.header["accessors"])
        columns = np.asarray(inverse, np.float32).transpose(0, 2, 1).reshape(len(inverse), 16)
        view = gltf.view(columns.tobytes())
        gltf.header["accessors"].append(
            {"bufferView": view, "componentType": 5126, "count": len(inverse), "type": "MAT4"}
        )
    return primitive


def _moved(x: float, y: float, z: float, scale: float = 1.0) -> np.ndarray:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


ONE_EACH = [[0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]]


def test_joints_place_a_skin_and_its_node_does_not(gltf, parts):
    _skinned(gltf, ONE_EACH, [[1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0]])
    (part,) = parts()
    # (2, 0, 0) on the second joint: turned to (0, 2, 0), moved by (100, 1, 0). (0, 2, 0) on both: half of
    # (100, 2, 0) and half of (-2, 0, 0) + (100, 1, 0).
    np.testing.assert_allclose(part.vertices, [[100, 0, 0], [100, 3, 0], [99, 1.5, 0]], atol=1e-5)


def test_inverse_bind_matrices_stand_before_the_joints(gltf, parts):
    """A mesh in centimetres, as in many files: the scale is in the bind matrices."""
    inverse = [_moved(0, 0, 0, scale=0.01), _moved(-1, 0, 0)]
    _skinned(gltf, ONE_EACH, [[1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]], inverse)
    (part,) = parts()
    np.testing.assert_allclose(part.vertices, [[100, 0, 0], [100, 2, 0], [100, 0.02, 0]], atol=1e-5)


def test_all_sets_of_joints_count_and_whole_weights_are_shares(gltf, parts):
    joints = [[0, 0, 0, 0, 1, 0, 0, 0]] * 3
    weights = np.array([[51, 0, 0, 0, 204, 0, 0, 0]] * 3, np.uint8)  # 0.2 and 0.8
    _skinned(gltf, joints, weights, sets=2)
    (part,) = parts()
    np.testing.assert_allclose(part.vertices, [[100, 0.8, 0], [100.4, 2.4, 0], [98.4, 1.2, 0]], atol=1e-5)


def test_a_skin_needs_its_joints(tmp_path, gltf):
    _skinned(gltf, [[5, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    with pytest.raises(InputError, match="bound to joint 5, and its skin has 2 joints"):
        load_mesh_scene(gltf.write(tmp_path / "a.glb"))


def test_a_hidden_skin_is_hidden_and_a_hidden_joint_still_places(gltf, parts):
    _skinned(gltf, ONE_EACH, [[1, 0, 0, 0]] * 3)
    gltf.header["nodes"][1] = _hidden(gltf.header["nodes"][1])
    assert parts()[0].vertices[0].tolist() == [100, 0, 0]
    gltf.header["nodes"][0] = _hidden(gltf.header["nodes"][0])
    assert parts() == []


def test_the_weights_of_a_node_go_before_those_of_its_mesh(gltf, parts):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE)
    up = gltf.accessor(np.tile(np.array([0, 0, 1], np.float32), (3, 1)))
    rows, values = gltf.view(np.array([2], np.uint8).tobytes()), gltf.view(np.array([[4, 0, 0]], np.float32).tobytes())
    sparse = {
        "count": 1,
        "indices": {"bufferView": rows, "componentType": 5121},
        "values": {"bufferView": values},
    }
    gltf.header["accessors"].append({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse})
    primitive["targets"] = [{"POSITION": up}, {"POSITION": len(gltf.header["accessors"]) - 1}, {}]
    gltf.header["meshes"][0]["weights"] = [0.5, 0, 1]
    gltf.header["nodes"] = [{"mesh": 0}, {"mesh": 0, "weights": [0, 0.25, 1], "translation": [0, 0, 7]}]
    by_mesh, by_node = parts()
    np.testing.assert_allclose(by_mesh.vertices, TRIANGLE + [0, 0, 0.5])
    np.testing.assert_allclose(by_node.vertices, [[0, 0, 7], [2, 0, 7], [1, 2, 7]])


def test_colours_and_texture_coordinates_have_targets_too_and_a_skin_moves_what_is_morphed(gltf, parts):
    primitive = _skinned(gltf, ONE_EACH, [[1, 0, 0, 0]] * 3)
    colors = np.tile(np.array([51, 51, 51], np.uint8), (3, 1))
    primitive["attributes"]["COLOR_0"] = gltf.accessor(colors, normalized=True)
    more = gltf.accessor(np.tile(np.array([0.2, 0, 0], np.float32), (3, 1)))
    primitive["targets"] = [
        {"POSITION": gltf.accessor(np.tile(np.array([2, 0, 0], np.float32), (3, 1))), "COLOR_0": more}
    ]
    gltf.header["nodes"][0]["weights"] = [2.0]
    (part,) = parts()
    np.testing.assert_allclose(part.colors, np.tile([0.6, 0.2, 0.2], (3, 1)), atol=1e-6)
    np.testing.assert_allclose(part.vertices[1], [100, 7, 0], atol=1e-5)  # (6, 0, 0) on the second joint


def test_a_target_of_another_length_is_said(tmp_path, gltf):
    primitive = gltf.triangle_mesh(TRIANGLE, FACE)
    primitive["targets"] = [{"POSITION": gltf.accessor(np.zeros((2, 3), np.float32))}]
    gltf.header["meshes"][0]["weights"] = [1.0]
    with pytest.raises(InputError, match="morph target has 2 values of POSITION for 3 vertices"):
        load_mesh_scene(gltf.write(tmp_path / "a.glb"))


def test_extensions_that_are_not_read_are_named(tmp_path, gltf, make_box):
    vertices, faces = make_box((0, 0, 0), (4, 2.5, 3))
    gltf.triangle_mesh(vertices, faces)
    gltf.header["extensionsUsed"] = [
        "KHR_materials_unlit", "KHR_texture_transform", "KHR_node_visibility", "CESIUM_RTC", "KHR_materials_holes",
    ]  # fmt: skip
    with pytest.warns(InputWarning, match=r"extensions that are not read \(CESIUM_RTC, KHR_materials_holes\)"):
        scene = load_mesh_scene(gltf.write(tmp_path / "a.glb"), up="y")
    assert any("CESIUM_RTC" in note for note in scene.notes)


@pytest.mark.parametrize("name", ["KHR_node_holograms", "KHR_materials_holes", "CESIUM_RTC"])
def test_a_required_extension_of_a_known_family_is_not_harmless_by_its_name(tmp_path, gltf, name):
    gltf.triangle_mesh(TRIANGLE, FACE)
    gltf.header["extensionsRequired"] = [name]
    with pytest.raises(InputError, match=f"it needs the glTF extension {name}"):
        load_mesh_scene(gltf.write(tmp_path / "a.glb"))
