from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.library import SCENES, check_scene_name, load_scene, with_options
from activestructure_gym.scenes.scene import Scene


@pytest.fixture
def hut(make_scene, make_box, monkeypatch):
    """A third party's scene, registered as the documentation shows."""
    monkeypatch.setattr(SCENES, "_entries", dict(SCENES._entries))

    @SCENES.register("hut")
    def make_hut(*, width: float = 3.0, seed: int = 0, roof: bool = True, kind: str = "wood",
                 size: tuple[float, float] = (1.0, 2.0), scale: str | float | None = None) -> Scene:  # fmt: skip
        scene = make_scene(*make_box((0, 0, 0), (width, 3, 2.5)), name="hut")
        object.__setattr__(scene, "source", repr((width, seed, roof, kind, size, scale)))
        return scene

    SCENES.register("nothing")(lambda: None)
    return make_hut


def test_a_registered_scene_with_typed_options(hut):
    assert load_scene("hut").source == repr((3.0, 0, True, "wood", (1.0, 2.0), None))
    spec = "hut?width=4&seed=7&roof=false&kind=stone&size=5,6.5&scale=0.5"
    assert load_scene(spec).source == repr((4.0, 7, False, "stone", (5.0, 6.5), 0.5))
    assert load_scene("hut?width=4&seed=7", seed=8, scale="mm").source == repr((4.0, 8, True, "wood", (1.0, 2.0), "mm"))
    assert load_scene("hut?width=4").bounds[1, 0] == 4.0


@pytest.mark.parametrize(
    "spec, said",
    [
        ("hutt", "unknown scene 'hutt'; did you mean 'hut'?"),
        ("hut?wdith=4", "unknown option 'wdith' of scene 'hut'; did you mean 'width'?"),
        ("hut?seed=two", "option seed of scene 'hut' must be a whole number, got 'two'"),
        ("hut?roof=maybe", "must be true or false, got 'maybe'"),
        ("hut?size=1", "must be 2 values with commas, got '1'"),
        ("", "a scene is a name, a mesh file or a folder, got ''"),
        ("replica:", "got 'replica:'"),
        ("mesh:?up=y", "got 'mesh:?up=y'"),
        (":", "neither a known name nor of the form package.module:Name"),
        ("hut?width", "not of the form key=value"),
        ("no_module_here:make", "no module called 'no_module_here'"),
        ("gone.glb", "there is no mesh file 'gone.glb'"),
        ("replica:gone", "there is no Replica scene 'gone'"),
        ("some/where/else", "there is no scene file or folder 'some/where/else'"),
        ("mesh:gone.obj?units=mm", "there is no mesh file 'gone.obj'"),
        ("gone.obj?unit=mm", "did you mean 'units'?"),
        (3, "a scene is a name, a path or a Scene, got 3"),
        (None, "a scene is a name, a path or a Scene, got None"),
        ("nothing", "scene 'nothing': its factory must return a Scene, and returned None"),
        ("os:getcwd", "scene 'os:getcwd': its factory must return a Scene, and returned '"),
        ("os:sep", "scene 'os:sep' must be a function with named options that returns a Scene, got '/'"),
        ("builtins:dict", "must be a function with named options"),
        ("a\nb", "unknown scene 'a\\nb'"),
        ("n" * 5000, "(5002 characters)"),
        ("/" + "n" * 5000, "there is no scene file or folder '/nnn"),
    ],
)
def test_mistakes_are_said_in_one_sentence(hut, spec, said):
    with pytest.raises(InputError) as caught:
        load_scene(spec)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_scan_is_named_without_the_suffix_of_its_file(tmp_path):
    check_scene_name("box?inside=1,1,1")  # an option of every scene
    (tmp_path / "Albertville.glb").touch()
    check_scene_name(f"gibson:{tmp_path}/Albertville")
    with pytest.raises(InputError, match="there is no scene file"):
        check_scene_name(f"gibson:{tmp_path}/Albert")


def test_a_factory_anywhere_on_the_path(tmp_path, monkeypatch):
    (tmp_path / "their_scenes.py").write_text(
        "import numpy as np\n"
        "from activestructure_gym.scenes import Scene, SceneMesh\n"
        "def triangle(*, side: float = 1.0) -> Scene:\n"
        "    corners = np.array([[0, 0, 0], [side, 0, 0], [0, side, 0]], np.float32)\n"
        "    mesh = SceneMesh(corners, np.array([[0, 1, 2]], np.int32), np.ones((3, 3), np.float32),\n"
        "                     np.zeros((3, 2), np.float32), np.array([-1], np.int32))\n"
        "    return Scene('triangle', mesh, 'theirs')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert load_scene("their_scenes:triangle?side=2.5").bounds[1, 0] == 2.5


def test_options_without_annotations_take_the_type_of_their_default(hut):
    @SCENES.register("bare")
    def bare(width=3.0, seed=0, roof=True, kind="wood"):
        return hut(width=width, seed=seed, roof=roof, kind=kind)

    assert load_scene("bare?width=4&seed=7&roof=no&kind=5").source.startswith("(4.0, 7, False, '5'")


@pytest.fixture
def mesh_file(tmp_path, make_box) -> Path:
    import trimesh

    path = tmp_path / "room.ply"
    trimesh.Trimesh(*make_box((0, 0, 0), (4000, 2500, 3000)), process=False).export(path)
    return path


def test_files_by_text_by_path_and_by_prefix(mesh_file):
    for scene in (
        load_scene(f"{mesh_file}?units=mm&up=y"),
        load_scene(mesh_file, units="mm", up="y"),
        load_scene(f"mesh:{mesh_file}?units=0.001", up="y"),
        load_scene(f"{mesh_file}?units=ft&up=y", units="mm"),  # the keyword wins
    ):
        np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [4, 3, 2.5], atol=1e-5)


def test_a_folder_with_one_mesh_is_that_mesh(mesh_file):
    assert load_scene(str(mesh_file.parent), units="mm").name == "room"
    (mesh_file.parent / "other.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match="it holds other.obj, room.ply"):
        load_scene(str(mesh_file.parent))


def test_a_file_name_with_a_question_mark(mesh_file):
    odd = mesh_file.rename(mesh_file.with_name("what?units=cm.ply"))
    assert load_scene(str(odd), units="mm").bounds[1, 0] == pytest.approx(4.0)
    assert load_scene(f"{odd}?units=mm&up=y").bounds[1, 0] == pytest.approx(4.0)


def test_replica_and_matterport_are_recognised(replica_folder, tmp_path, gltf, make_box):
    room, sequence = replica_folder / "room_a", replica_folder / "seq" / "room_a"
    assert load_scene(str(room)).labels is None
    assert load_scene(str(room / "habitat" / "mesh_semantic.ply")).labels is not None
    assert load_scene(f"{room}/habitat/replica_stage.stage_config.json").labels is not None
    assert len(load_scene(f"replica:{room}?sequence={sequence}").evaluation_views) == 3
    folder = tmp_path / "mp3d" / "abc"
    folder.mkdir(parents=True)
    gltf.triangle_mesh(*make_box((0, 0, 0), (4, 3, 2.5)))
    gltf.write(folder / "abc.glb")
    (folder / "abc.house").touch()
    for spec in (f"{folder}", f"matterport3d:{folder}", f"matterport3d:{folder}/abc.glb", f"{folder}/abc.glb"):
        assert load_scene(spec).name == "abc"
    with pytest.raises(InputError, match="is a folder of scenes; give one of them: .*abc"):
        load_scene(str(folder.parent))


def test_the_folder_one_stands_in(replica_folder, monkeypatch):
    monkeypatch.chdir(replica_folder / "room_a")
    assert load_scene(".").name == load_scene("replica:.").name == "room_a"
    monkeypatch.chdir("habitat")
    assert load_scene("replica:..").name == "room_a"
    monkeypatch.chdir(replica_folder / "seq")
    with pytest.raises(InputError, match="is not a Replica scene"):
        load_scene("replica:.")


def test_a_loaded_scene_passes_through(furnished_room):
    assert load_scene(furnished_room) is furnished_room
    with pytest.raises(InputError, match="loaded already"):
        load_scene(furnished_room, seed=3)


def test_loaders_are_no_scenes_by_themselves():
    with pytest.raises(InputError, match="unknown scene 'mesh'"):
        load_scene("mesh")


def test_embedded_scenes_by_name():
    scene = load_scene("box?size=5,4,3")
    np.testing.assert_allclose(scene.bounds[1] - scene.bounds[0], [5, 4, 3], atol=0.2)
    assert {"box", "room", "apartment"} <= set(SCENES)


@pytest.mark.parametrize("size", [[5.0, 4.0, 3.0], np.array([5.0, 4.0, 3.0]), (5, 4, 3), "5,4,3"])
def test_the_size_of_a_box_may_be_any_three_numbers(size):
    assert load_scene("box", size=size) is load_scene("box?size=5,4,3")


@pytest.mark.parametrize(
    ("spec", "options", "said"),
    [
        ("box", {"size": ("a", 1, 2)}, "a box room needs three sizes"),
        ("box", {"size": [[1, 2], 3, 4]}, "a box room needs three sizes"),
        ("box", {"size": {"x": 1}}, "the option size of a scene is a number"),
        ("room", {"seed": [1]}, "a scene's seed is a whole number"),
        ("apartment", {"rooms": {1}}, "the option rooms of a scene is a number"),
    ],
)
def test_options_that_are_no_numbers_are_one_sentence(spec, options, said):
    with pytest.raises(InputError, match=said):
        load_scene(spec, **options)


@pytest.mark.parametrize(
    "path", ["a" * 300 + ".obj", "/tmp/" + "a" * 300 + "/x.obj", "a" * 300 + ".stage_config.json", "b" * 300 + ".glb"]
)
def test_a_name_that_no_file_can_have_is_one_sentence(path):
    for spec in (path, Path(path)):
        with pytest.raises(InputError, match="a scene cannot be read: File name too long"):
            load_scene(spec)
    with pytest.raises(InputError, match="File name too long"):
        with_options(path, {"seed": 1})


def test_a_folder_that_may_not_be_looked_into_is_one_sentence(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", refuse)  # root may look into any
    with pytest.raises(InputError, match="a scene cannot be read: Permission denied"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"vertices": np.full((8, 3), np.nan, np.float32)}, "8 of 8 vertices are not finite"),
        ({"vertices": np.zeros((8, 2), np.float32)}, r"vertices must be \[V, 3\], got \(8, 2\)"),
        ({"faces": np.full((12, 3), 5000, np.int32)}, "faces must point to the 8 vertices"),
        ({"colors": np.zeros((3, 3), np.float32)}, r"colors and uv need one row per vertex \(8\)"),
    ],
)
def test_the_mesh_of_a_third_party_is_looked_at(hut, change, said):
    @SCENES.register("ruin")
    def make_ruin() -> Scene:
        scene = hut()
        return replace(scene, mesh=replace(scene.mesh, **change))

    with pytest.raises(InputError, match=f"scene 'ruin': its mesh cannot be used: {said}"):
        load_scene("ruin")


def test_options_are_added_to_a_text_or_refused(hut, mesh_file, furnished_room):
    assert with_options("hut", {"seed": 4}) == "hut?seed=4"
    assert with_options("hut?width=4", {"seed": 4, "roof": False}) == "hut?width=4&seed=4&roof=False"
    assert load_scene(with_options("hut?width=4", {"seed": 4})).source == load_scene("hut?width=4&seed=4").source
    for scene, said in (
        ("hut?seed=3", "the scene 'hut?seed=3' gives its own seed"),
        (str(mesh_file), "has no option 'seed'"),
        (mesh_file, "has no option 'seed'"),
        (furnished_room, "is loaded already, so its options cannot be changed: remove seed"),
        ("hutt", "did you mean 'hut'"),
    ):
        with pytest.raises(InputError, match=said.replace("?", r"\?")):
            with_options(scene, {"seed": 4})


@pytest.mark.parametrize(
    "kind", ["mesh", "replica", "matterport3d", "procthor", "scannet", "scannetpp", "hm3d", "gibson", "habitat"]
)
@pytest.mark.parametrize("path", ["x" * 5000, "/"])
def test_a_path_that_none_can_be_is_one_sentence(kind, path):
    with pytest.raises(InputError) as error:
        load_scene(f"{kind}:{path}")
    assert len(str(error.value)) < 500


@pytest.mark.parametrize("inside", ["1,1.5,1", (1, 1.5, 1), np.array([1, 1.5, 1])])
def test_every_scene_takes_a_point_of_the_region_that_is_used(mesh_file, hut, inside):
    for spec, options in (("box", {}), (str(mesh_file), {"units": "mm", "up": "z"})):
        scene = load_scene(spec, inside=inside, **options)
        plain = load_scene(spec, **options)
        assert scene.inside == (1.0, 1.5, 1.0) and plain.inside is None
        assert scene.content_hash != plain.content_hash
    assert load_scene("box?inside=1,1.5,1").content_hash == load_scene("box", inside=inside).content_hash
    assert with_options("box?inside=1,1.5,1", {"seed": 3}) == "box?inside=1,1.5,1&seed=3"
    assert with_options("box", {"inside": "1,1,1"}) == "box?inside=1,1,1"


@pytest.mark.parametrize("inside", ["1,2", "1,2,3,4", "a,b,c", "nan,1,1", "inf,1,1", "", 3, [1, 2, [3]], {"x": 1}])
def test_a_point_that_is_none_is_one_sentence(inside):
    with pytest.raises(
        InputError, match="inside of scene 'box' is a point of free space, three numbers x,y,z"
    ) as caught:
        load_scene("box", inside=inside)
    assert "\n" not in str(caught.value)


def test_a_point_outside_of_the_bounds_names_them():
    with pytest.raises(
        InputError, match=r"in the scene's bounds, \(0.00, 0.00, 0.00\) to \(4.00, 3.00, 2.50\) m, got 9"
    ):
        load_scene("box?inside=9,1,1")


def test_a_factory_may_have_an_option_of_that_name_itself(hut):
    @SCENES.register("well")
    def make_well(*, inside: float = 1.0) -> Scene:
        return replace(hut(), source=f"well({inside})")

    scene = load_scene("well?inside=2")
    assert scene.source == "well(2.0)" and scene.inside is None
