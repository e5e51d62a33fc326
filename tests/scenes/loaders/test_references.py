from __future__ import annotations

import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.mesh_loader import texture_notes
from activestructure_gym.scenes.loaders.mesh_parts import TextureStore
from activestructure_gym.scenes.loaders.references import find_reference


@pytest.mark.parametrize(
    "reference",
    ["../textures/oak wood.png", "../textures/oak%20wood.png", "..\\textures\\oak wood.png", "C:\\Users\\me\\plain.png",
     "-halo 2 plain.png", "plain.png # the floor", "./plain.png"],
)  # fmt: skip
def test_references_are_found_wherever_exporters_point(tmp_path, reference):
    (tmp_path / "textures").mkdir()
    (tmp_path / "models").mkdir()
    (tmp_path / "textures" / "oak wood.png").write_bytes(b"x")
    (tmp_path / "models" / "plain.png").write_bytes(b"x")
    assert find_reference(tmp_path / "models", reference).read_bytes() == b"x"


def test_the_last_word_of_a_name_is_no_name(tmp_path):
    (tmp_path / "wood.png").write_bytes(b"x")
    with pytest.raises(FileNotFoundError):
        find_reference(tmp_path, "oak wood.png")
    (tmp_path / "wood #2.png").write_bytes(b"y")
    assert find_reference(tmp_path, "wood #2.png").read_bytes() == b"y"


def test_nothing_outside_of_the_model_is_opened(tmp_path):
    """Meshes stand beside their textures; a file of a stranger has no business anywhere else."""
    models = tmp_path / "flat" / "models"
    models.mkdir(parents=True)
    Image.new("RGB", (4, 4)).save(tmp_path / "secret.png")
    store = TextureStore()
    for reference in ("../../secret.png", str(tmp_path / "secret.png"), f"file://{tmp_path}/secret.png"):
        assert store.add_file(models, reference) == -1
        assert f"is outside '{models.parent}'" in store.unreadable[-1]
    assert store.add_file(models, "x" * 5000) == -1 and len(store.unreadable[-1]) <= 200
    (models.parent / "near.png").write_bytes(b"x")
    assert find_reference(models, "../near.png").is_file()
    with pytest.raises(ValueError, match="outside"):
        find_reference(models, "../near.png", climb=0)


def test_a_name_that_begins_with_a_blank(tmp_path):
    (tmp_path / " wood.png").write_bytes(b"x")
    (tmp_path / "oak.png").write_bytes(b"x")
    assert find_reference(tmp_path, " wood.png").name == " wood.png"
    assert find_reference(tmp_path, " oak.png\n").name == "oak.png"


@pytest.mark.parametrize("folder", ["meshes/textures", "meshes/materials/textures", "textures", "materials/textures"])
@pytest.mark.parametrize(
    "reference", ["Wood.PNG", "model://flat/materials/textures/Wood.PNG", "wood.png", "X:\\\\wOOD.png"]
)
def test_pictures_in_the_usual_folders_around_a_mesh(tmp_path, folder, reference):
    (tmp_path / "meshes").mkdir()
    (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (4, 4), (120, 80, 40)).save(tmp_path / folder / "Wood.PNG")
    store = TextureStore()
    assert store.add_file(tmp_path / "meshes", reference) == 0 and not store.unreadable
    with pytest.raises(FileNotFoundError):  # a buffer or another mesh is no picture
        find_reference(tmp_path / "meshes", reference)


def test_the_case_of_letters_counts_where_it_can(tmp_path):
    (tmp_path / "Maps").mkdir()
    for name in ("wood.png", "Wood.png"):
        (tmp_path / "Maps" / name).write_bytes(name.encode())
    assert find_reference(tmp_path, "maps/Wood.png").read_bytes() == b"Wood.png"
    assert find_reference(tmp_path, "Maps/wood.png").read_bytes() == b"wood.png"
    assert find_reference(tmp_path, "maps/WOOD.PNG").read_bytes() == b"Wood.png"
    (tmp_path / "up.png").write_bytes(b"x")
    for name in ("../UP.png", "no\0name.png", "x" * 5000):
        with pytest.raises(FileNotFoundError):
            find_reference(tmp_path / "Maps", name, climb=0)


def test_a_missing_picture_is_said_with_the_folders_that_were_searched(tmp_path):
    store = TextureStore()
    store.add_file(tmp_path, "gone.png")
    assert texture_notes(store) == [
        f"1 texture or material files could not be read (gone.png), searched in '{tmp_path}', textures, "
        "materials/textures, ../textures, ../materials/textures; plain colours replace them"
    ]
