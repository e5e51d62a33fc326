"""Procedural scenes that are kept on disk equal those that are made."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.library import _kept_apartment
from activestructure_gym.scenes.procedural import apartment, kept
from activestructure_gym.scenes.procedural.apartment import make_apartment
from activestructure_gym.scenes.procedural.kept import kept_scene
from activestructure_gym.scenes.scene import Scene


@pytest.fixture(autouse=True)
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def made() -> Scene:
    return make_apartment(seed=3, rooms=1, lit=False)


@pytest.fixture
def counted(made: Scene, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The seeds of the scenes that were made, and not read."""
    seeds: list[int] = []
    monkeypatch.setattr(apartment, "make_apartment", lambda *, seed, **_: (seeds.append(seed), made)[1])
    return seeds


def load(**options: int | bool) -> Scene:
    return _kept_apartment(**{"seed": 3, "rooms": 1, "furnished": True, "lit": False, **options})


def test_a_scene_from_disk_is_the_scene_that_was_made(made: Scene, counted: list[int]) -> None:
    for back in (load(), load()):
        assert (back.name, back.source, back.content_hash) == (made.name, made.source, made.content_hash)
        assert back.labels is not None and made.labels is not None and back.labels.names == made.labels.names
        np.testing.assert_array_equal(back.labels.face_part, made.labels.face_part)
        np.testing.assert_array_equal(back.labels.structural, made.labels.structural)
        assert [texture.shape for texture in back.mesh.textures] == [texture.shape for texture in made.mesh.textures]
        assert not back.mesh.wrong()
    assert counted == [3]
    load(seed=4), load(lit=True), load(rooms=2)
    assert len(counted) == 4


def test_other_sources_make_a_scene_anew(counted: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    load()
    monkeypatch.setattr(kept, "_makers", lambda: "other")
    load()
    assert counted == [3, 3]


def test_a_damaged_file_is_made_anew(counted: list[int], directory: Path) -> None:
    load()
    (file,) = directory.glob("apartment-*.npz")
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    load(), load()
    assert counted == [3, 3]


def test_two_that_make_one_scene_at_once_both_get_it(made: Scene, directory: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: kept_scene("twice", lambda: made).content_hash, range(16)))
    assert set(found) == {made.content_hash}
    assert [file.suffix for file in directory.iterdir()] == [".npz"]


@pytest.mark.parametrize("wrong", [{"seed": -1}, {"rooms": 8}])
def test_what_cannot_be_made_is_refused_and_not_kept(wrong: dict[str, int], directory: Path) -> None:
    with pytest.raises(InputError):
        load(**wrong)
    assert not list(directory.iterdir())
