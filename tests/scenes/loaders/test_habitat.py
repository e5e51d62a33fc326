"""Datasets that are configured for Habitat, in a small one with a stage, an object and two scenes."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.budget import LIMITS
from activestructure_gym.scenes.loaders.habitat import is_habitat, load_habitat_scene

PUBLISHED = Path(__file__).resolve().parents[4] / "shared" / "data" / "habitat"
CHEST = "objects/chest.object_config.json"


def written(gltf_class, path, vertices, faces):
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = gltf_class()
    writer.triangle_mesh(np.asarray(vertices, float), faces)
    writer.write(path)


def table(path, **content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


@pytest.fixture
def dataset(tmp_path, gltf, make_box):
    """A room 6 x 4 m and 2.6 m high in Habitat's axes (y up), and a chest .4 x 1 x .6 m built in centimetres with
    its own up (z) and front (+x)."""
    kind = type(gltf)
    written(kind, tmp_path / "assets" / "room.glb", *make_box((-3, 0, -2), (3, 2.6, 2)))
    written(kind, tmp_path / "objects" / "chest.glb", *make_box((0, 0, 0), (60, 40, 100)))
    table(tmp_path / "stages" / "room.stage_config.json", render_asset="../assets/room.glb", up=[0, 1, 0])
    chest = {"render_asset": "chest.glb", "up": [0, 0, 1], "front": [1, 0, 0], "units_to_meters": 0.01}
    table(tmp_path / "objects" / "chest.object_config.json", **chest)
    here = {"template_name": "chest", "translation": [1.0, 0.5, -1.0]}
    table(
        tmp_path / "scenes" / "one.scene_instance.json",
        stage_instance={"template_name": "stages/room"},
        object_instances=[here, {**here, "translation": [-2.0, 0.0, 0.0], "translation_origin": "asset_local"}],
    )
    table(tmp_path / "scenes" / "empty.scene_instance.json", stage_instance={"template_name": "room"})
    path = tmp_path / "small.scene_dataset_config.json"
    table(
        path,
        stages={"paths": {".json": ["stages"]}, "default_attributes": {"front": [0, 0, -1]}},
        objects={"paths": {".json": ["objects/*.object_config.json"]}},
        scene_instances={"paths": {".json": ["scenes/"]}},
    )
    return path


def boxes(scene, room=8):
    """Corners of what stands beside the room's eight vertices, in eights."""
    rest = scene.mesh.vertices[room:].reshape(-1, 8, 3)
    return np.sort(np.stack([rest.min(axis=1), rest.max(axis=1)], axis=1), axis=1)


def test_objects_stand_where_the_scene_puts_them(dataset):
    scene = load_scene(f"{dataset}?scene=one")
    assert scene.name == "one"
    # y up becomes z up: Habitat's (x, y, z) is (x, -z, y) here.
    np.testing.assert_allclose(scene.bounds, [[-3, -2, 0], [3, 2, 2.6]], atol=1e-6)
    by_middle, by_origin = boxes(scene)
    # Along its front (.6 m), which becomes Habitat's -z and our +y; to its right .4 m, along x; 1 m high.
    np.testing.assert_allclose(by_middle, [[0.8, 0.7, 0.0], [1.2, 1.3, 1.0]], atol=1e-6)
    # Its own origin is a corner: it reaches 1 m up, .6 m ahead, and .4 m to its left, since its y axis points there.
    np.testing.assert_allclose(by_origin, [[-2.4, 0.0, 0.0], [-2.0, 0.6, 1.0]], atol=1e-6)


def test_rotations_and_scales_of_an_instance(dataset):
    scene = dataset.parent / "scenes" / "one.scene_instance.json"
    content = json.loads(scene.read_text())
    half = np.sqrt(0.5)
    content["object_instances"] = [
        # A quarter turn about Habitat's up, from -z (ahead) to -x (left).
        {"template_name": "chest", "translation": [0, 0.5, 0], "rotation": [half, 0, half, 0], "uniform_scale": 2.0},
        {"template_name": "chest", "translation": [0, 0.5, 0], "non_uniform_scale": [1.0, 1.0, -1.0]},
    ]
    scene.write_text(json.dumps(content))
    turned, mirrored = boxes(load_scene(f"{dataset}?scene=one"))
    np.testing.assert_allclose(turned, [[-0.6, -0.4, -0.5], [0.6, 0.4, 1.5]], atol=1e-6)
    np.testing.assert_allclose(mirrored, [[-0.2, -0.3, 0.0], [0.2, 0.3, 1.0]], atol=1e-6)
    mesh = load_scene(f"{dataset}?scene=one").mesh

    def facing(faces):
        """Whether each triangle's corners run so that it looks away from the middle of them all."""
        a, b, c = np.moveaxis(mesh.vertices[faces].astype(float), 1, 0)
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), a - np.mean([a, b, c], axis=(0, 1))) > 0

    np.testing.assert_array_equal(facing(mesh.faces[-12:]), facing(mesh.faces[-24:-12]))  # not turned inside out


def test_what_is_transparent_is_left_out_and_the_rest_stays_in_its_place(dataset, gltf, make_box):
    """A pole in an invisible box: the middle by which it is placed is that of the box."""
    gltf.triangle_mesh(*make_box((0, 0, 0), (60, 40, 100)), material=0)
    gltf.triangle_mesh(*make_box((0, 0, 0), (10, 10, 100)))
    gltf.header["materials"] = [
        {"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0]}},
    ]
    gltf.write(dataset.parent / "objects" / "chest.glb")
    scene = load_scene(f"{dataset}?scene=one")
    by_middle, by_origin = boxes(scene)
    np.testing.assert_allclose(by_middle, [[1.1, 0.7, 0.0], [1.2, 0.8, 1.0]], atol=1e-6)
    np.testing.assert_allclose(by_origin, [[-2.1, 0.0, 0.0], [-2.0, 0.1, 1.0]], atol=1e-6)
    assert any("12 faces are transparent" in note for note in scene.notes)
    gltf.header["nodes"] = [{"mesh": 0}]
    gltf.write(dataset.parent / "objects" / "chest.glb")
    assert len(load_scene(f"{dataset}?scene=one").mesh.faces) == 12  # the room alone


def changed(path, **content):
    table(path, **{**json.loads(path.read_text()), **content})


def test_a_template_is_scaled_along_habitats_axes(dataset):
    # .4 x 1 x .6 m to the right, up and back: twice as high, whichever axis of the asset that is.
    changed(dataset.parent / "objects" / "chest.object_config.json", scale=[1.0, 2.0, 1.0])
    by_middle, by_origin = boxes(load_scene(f"{dataset}?scene=one"))
    np.testing.assert_allclose(by_middle, [[0.8, 0.7, -0.5], [1.2, 1.3, 1.5]], atol=1e-6)
    np.testing.assert_allclose(by_origin, [[-2.4, 0.0, 0.0], [-2.0, 0.6, 2.0]], atol=1e-6)


def test_an_object_is_placed_by_the_centre_of_mass_that_is_said(dataset):
    # Its corner: what is placed by its own origin stays where it is.
    changed(dataset.parent / "objects" / "chest.object_config.json", COM=[0, 0, 0])
    by_mass, by_origin = boxes(load_scene(f"{dataset}?scene=one"))
    np.testing.assert_allclose(by_origin, [[-2.4, 0.0, 0.0], [-2.0, 0.6, 1.0]], atol=1e-6)
    np.testing.assert_allclose(by_mass, by_origin + [3.0, 1.0, 0.5], atol=1e-6)
    # In Habitat's axes, and scaled as the template is: its foot's middle.
    changed(dataset.parent / "objects" / "chest.object_config.json", COM=[-0.2, 0, -0.3], scale=[1, 1, 0.5])
    np.testing.assert_allclose(boxes(load_scene(f"{dataset}?scene=one"))[0], [[0.8, 0.85, 0.5], [1.2, 1.15, 1.5]])


def test_whole_names_and_configurations_come_first(dataset, tmp_path):
    # The bare mesh chest.glb has the configuration's name, and a folder holds another chest.
    (tmp_path / "objects" / "old").mkdir()
    (tmp_path / "objects" / "old" / "chest.glb").write_bytes(b"no mesh")
    content = json.loads(dataset.read_text())
    content["objects"]["paths"][".glb"] = ["objects/**/*.glb"]
    dataset.write_text(json.dumps(content))
    instance = dataset.parent / "scenes" / "one.scene_instance.json"
    changed(instance, object_instances=[{"template_name": "objects/chest", "translation": [1.0, 0.5, -1.0]}])
    (chest,) = boxes(load_scene(f"{dataset}?scene=one"))
    np.testing.assert_allclose(chest, [[0.8, 0.7, 0.0], [1.2, 1.3, 1.0]], atol=1e-6)


def test_a_template_of_which_there_are_two_is_named_with_both(dataset, tmp_path):
    (tmp_path / "objects" / "old").mkdir()
    shutil.copy(tmp_path / "objects" / "chest.object_config.json", tmp_path / "objects" / "old")
    changed(dataset, objects={"paths": {".json": ["objects", "objects/old"]}})
    with pytest.raises(InputError, match="names 'chest', which fits several objects: objects/chest, objects/old/c"):
        load_scene(f"{dataset}?scene=one")
    with pytest.raises(InputError, match="max_texture is the largest side"):
        load_scene(f"{dataset}?scene=empty&max_texture=0")


def test_more_copies_than_a_scene_may_have_are_refused(dataset, monkeypatch):
    few = replace(LIMITS["triangles"], allowance=40, per_byte=0.0)  # two rooms' and an object's 12 each, not two
    monkeypatch.setitem(LIMITS, "triangles", few)
    with pytest.raises(InputError, match="one.scene_instance.json' is too large: .* 40 triangles"):
        load_scene(f"{dataset}?scene=one")


def test_a_folder_that_may_not_be_read_is_one_sentence(dataset, monkeypatch):
    def refused(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "iterdir", refused)
    with pytest.raises(InputError, match="names a path that cannot be read: .*Permission denied"):
        load_scene(f"{dataset}?scene=one")


def test_without_objects_it_is_the_stage(dataset):
    alone = load_habitat_scene(dataset, scene="one", objects=False)
    empty = load_habitat_scene(dataset, scene="empty")
    assert len(alone.mesh.vertices) == 8 and alone.content_hash == empty.content_hash


def test_a_dataset_of_stages_alone_has_them_as_scenes(dataset):
    content = json.loads(dataset.read_text())
    stages = {"paths": {".glb": ["assets/*.glb"]}, "default_attributes": {"up": [0, 0, 1], "front": [0, 1, 0]}}
    dataset.write_text(json.dumps({"stages": stages, "objects": content["objects"]}))
    scene = load_scene(str(dataset))  # the only one
    assert scene.name == "room"
    # Now its z is up: 2.6 m lie along y.
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), [6, 2.6, 4], atol=1e-6)


@pytest.mark.parametrize(
    "file, change, wanted",
    [
        ("small.scene_dataset_config.json", {"stages": [], "scene_instances": {}}, "'stages' of .* must be a table"),
        ("small.scene_dataset_config.json", {"stages": {}, "scene_instances": {}}, "without stages"),
        ("small.scene_dataset_config.json", {"objects": {}}, "unknown template among the objects"),
        ("stages/room.stage_config.json", {"render_asset": "../../../etc/passwd"}, "not in the dataset"),
        ("stages/room.stage_config.json", {"render_asset": None}, "names no render_asset"),
        ("stages/room.stage_config.json", {"front": [0, 1, 0]}, "must be perpendicular"),
        ("stages/room.stage_config.json", {"up": "y"}, "up of .* must be 3 finite numbers"),
        ("stages/room.stage_config.json", {"origin": [1, 0, 0]}, "moves its stage by an origin"),
        ("stages/room.stage_config.json", {"units_to_meters": 0}, "must be above 0"),
        ("scenes/one.scene_instance.json", {"stage_instance": None}, "names no stage_instance"),
        (
            "scenes/one.scene_instance.json",
            {"stage_instance": {"template_name": "hall"}},
            "unknown template among the stages.*Known: room",
        ),
        ("scenes/one.scene_instance.json", {"object_instances": [7]}, "not a table"),
        (
            "scenes/one.scene_instance.json",
            {"object_instances": [{"translation": [0, 0, 0]}]},
            "without a template_name",
        ),
        (
            "scenes/one.scene_instance.json",
            {"object_instances": [{"template_name": "chest", "rotation": [0, 0, 0, 0]}]},
            "not a unit quaternion",
        ),
    ],
)
def test_what_cannot_be_used_is_one_sentence(dataset, file, change, wanted):
    path = dataset.parent / file
    content = {**json.loads(path.read_text()), **change}
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))
    with pytest.raises(InputError, match=wanted):
        load_scene(f"{dataset}?scene=one")


def test_a_scene_must_be_named_where_there_are_several(dataset):
    with pytest.raises(InputError, match="holds 2 scenes; choose one with \\?scene=NAME, such as: empty, one"):
        load_scene(str(dataset))
    with pytest.raises(InputError, match="one"):
        load_scene(f"{dataset}?scene=on")
    with pytest.raises(InputError, match="no dataset configuration"):
        load_scene("habitat:nowhere.scene_dataset_config.json")


@pytest.fixture
def with_configs(dataset):
    """The dataset with changed templates: a room of twice the height, a small chest, and a chest from the defaults."""
    content = json.loads(dataset.read_text())
    hall = {"original_file": "stages/room.stage_config.json", "template_handle": "hall"}
    content["stages"]["configs"] = [
        {**hall, "attributes": {"scale": [1, 2, 1]}},
        {"original_file": "stages/gone.stage_config.json", "template_handle": "gone", "attributes": {}},
    ]
    content["objects"]["default_attributes"] = {"up": [0, 0, 1], "front": [1, 0, 0]}
    content["objects"]["configs"] = [
        {"original_file": CHEST, "template_handle": "small", "attributes": {"scale": [1, 0.5, 1]}},
        {"template_handle": "new", "attributes": {"render_asset": "objects/chest.glb", "units_to_meters": 0.02}},
    ]
    dataset.write_text(json.dumps(content))
    return dataset


def with_entries(dataset, kind, entries):
    content = json.loads(dataset.read_text())
    content[kind]["configs"] = entries
    dataset.write_text(json.dumps(content))
    return dataset


def placed(dataset, *templates, stage="hall"):
    """The scene ``one`` with objects of these templates, each 0.5 m above the origin."""
    table(
        dataset.parent / "scenes" / "one.scene_instance.json",
        stage_instance={"template_name": stage},
        object_instances=[{"template_name": name, "translation": [0, 0.5, 0]} for name in templates],
    )
    return load_scene(f"{dataset}?scene=one")


def test_templates_are_defined_within_the_datasets_configuration(with_configs):
    scene = placed(with_configs, "chest", "small", "new")
    np.testing.assert_allclose(scene.mesh.vertices[:8].max(axis=0), [3, 2, 5.2], atol=1e-6)
    sizes = np.ptp(boxes(scene), axis=1)
    np.testing.assert_allclose(sizes, [[0.4, 0.6, 1.0], [0.4, 0.6, 0.5], [0.8, 1.2, 2.0]], atol=1e-6)


def test_a_template_without_a_new_name_changes_its_original(with_configs):
    half, tenfold = {"scale": [1, 0.5, 1]}, {"units_to_meters": 0.1}
    with_entries(with_configs, "objects", [{"original_file": CHEST, "attributes": half}])
    np.testing.assert_allclose(np.ptp(boxes(placed(with_configs, "chest")), axis=1), [[0.4, 0.6, 0.5]], atol=1e-6)
    further = {"original_file": CHEST, "template_handle": "next", "attributes": tenfold}
    with_entries(with_configs, "objects", [{"original_file": CHEST, "attributes": half}, further])
    np.testing.assert_allclose(np.ptp(boxes(placed(with_configs, "next")), axis=1), [[4.0, 6.0, 5.0]], atol=1e-5)


@pytest.mark.parametrize(
    ("configs", "message"),
    [
        ({}, "configs of stages in .* must be a list of tables"),
        ([7], "configs of stages in .* must be a list of tables"),
        ([{"template_handle": "a"}], "an entry without attributes"),
        ([{"attributes": {}}], "without original_file and template_handle"),
        ([{"template_handle": "hall", "attributes": {}}], "small.scene_dataset_config.json' names no render_asset"),
    ],
)
def test_configs_that_cannot_be_used_are_one_sentence(with_configs, configs, message):
    with pytest.raises(InputError, match=message):
        placed(with_entries(with_configs, "stages", configs), "chest")


def test_an_original_that_is_missing_leaves_its_template_out(with_configs):
    with pytest.raises(InputError, match="unknown template among the stages of .* 'gone'"):
        placed(with_configs, stage="gone")


def test_a_template_is_found_by_whole_words_of_its_name(with_configs):
    entries = [
        {"original_file": CHEST, "template_handle": name, "attributes": {}} for name in ("chest_oak_b", "chest_pine2_b")
    ]
    with_entries(with_configs, "objects", entries)
    assert len(placed(with_configs, "oak").mesh.faces) == 24
    with pytest.raises(InputError, match="unknown template among the objects of .* 'pine'"):
        placed(with_configs, "pine")
    said = "'b' fits several objects: chest_oak_b, chest_pine2_b; the first is used"
    with pytest.warns(InputWarning, match=said):
        placed(with_configs, "b")


def test_a_stage_configuration_is_a_scene_too(dataset):
    stage = dataset.parent / "stages" / "room.stage_config.json"
    changed(stage, up=[0, 0, 1], front=[0, 1, 0], render_asset="../assets/room.glb")
    scene = load_scene(str(stage))
    assert scene.name == "room"
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), [6, 2.6, 4], atol=1e-6)
    odd = stage.rename(stage.with_name("[a] room.stage_config.json"))
    assert load_scene(f"habitat:{odd}").content_hash == scene.content_hash
    for content in ({"render_asset": "mesh.ply"}, {"render_asset": 7}, {}):  # Replica's, or unknown
        table(stage, **content)
        assert not is_habitat(stage)
    stage.write_text("[")
    assert not is_habitat(stage) and not is_habitat(stage.with_name("gone.stage_config.json"))


@pytest.mark.parametrize("name", ["TEEsavR23oF", "00800-TEEsavR23oF", "TEEsavR23oF.basis", "val/00800-TEEsavR23oF"])
@pytest.mark.parametrize("plain", [False, True])
def test_scans_of_hm3d_have_their_natural_names(tmp_path, gltf, make_box, name, plain):
    """The stages of the configuration are the copies for Habitat; a scan's own mesh next to them is read instead."""
    kind = type(gltf)
    for scan in ("00800-TEEsavR23oF", "00801-TEEsavR23oG"):
        folder = tmp_path / "val" / scan
        written(kind, folder / f"{scan[6:]}.basis.glb", *make_box((-3, -2, 0), (3, 2, 2.6)))
        if plain:
            written(kind, folder / f"{scan[6:]}.glb", *make_box((-2.5, -2, 0), (2.5, 2, 2.6)))
    path = tmp_path / "hm3d.scene_dataset_config.json"
    usual = {"up": [0, 0, 1], "front": [0, 1, 0], "origin": [0, 0, 0]}
    table(path, stages={"default_attributes": usual, "paths": {".glb": ["val/*/*.basis.glb"]}})
    scene = load_scene(f"{path}?scene={name}")
    assert scene.name == "TEEsavR23oF"
    np.testing.assert_allclose(np.ptp(scene.bounds, axis=0), [5 if plain else 6, 4, 2.6], atol=1e-6)
    with pytest.raises(InputError, match="holds 2 scenes"):
        load_scene(f"{path}?scene=val")


MOVED = [[-8.9, -13.3], [11.1, 6.7]]  # scaled by 1, not by 2 as in the stage's own file, and moved by (1.1, -3.3) m


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="Habitat's test datasets are not here")
@pytest.mark.parametrize(
    ("file", "bounds"),
    [
        ("dataset_tests/dataset_0/test_dataset_0.scene_dataset_config.json", MOVED),
        ("dataset_tests/dataset_1/test_dataset_1.scene_dataset_config.json?scene=dataset_test_scene_0", MOVED),
        ("scenes/simple_room.stage_config.json", [[-5.25, -5.4], [5.28, 5.45]]),
        ("scenes/stage_floor1.stage_config.json", [[-20, -20], [20, 20]]),
    ],
)
def test_habitats_own_datasets(file, bounds):
    with pytest.warns(InputWarning):  # they have no ceiling
        scene = load_scene(f"{PUBLISHED}/{file}")
    np.testing.assert_allclose(scene.bounds[:, :2], bounds, atol=0.01)
