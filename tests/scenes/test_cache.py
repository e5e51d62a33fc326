from __future__ import annotations

import os

import numpy as np
import pytest

from activestructure_gym.scenes.cache import cache_directory, cached_arrays


class Counted:
    """Counts how often it is asked to compute."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> dict[str, np.ndarray]:
        self.calls += 1
        return {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.float64(1.5)}


@pytest.fixture(autouse=True)
def directory(tmp_path, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path / "deep" / "cache"))
    return tmp_path / "deep" / "cache"


def test_computed_once_and_equal_ever_after(directory):
    compute = Counted()
    first, second = cached_arrays("key", compute), cached_arrays("key", compute)
    assert compute.calls == 1
    assert second["a"].dtype == np.float32 and float(second["b"]) == 1.5
    np.testing.assert_array_equal(first["a"], second["a"])
    assert [file.suffix for file in directory.iterdir()] == [".npz"]  # nothing half-written beside it
    cached_arrays("other key", compute)
    assert compute.calls == 2


def test_compressed_files_of_older_versions_are_read_and_replaced(directory):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    plain = file.read_bytes()
    np.savez_compressed(file, **{**Counted()(), "a": np.full((300, 20), 7.0)})
    packed = file.stat().st_size
    np.testing.assert_array_equal(cached_arrays("key", compute)["a"], np.full((300, 20), 7.0))
    assert compute.calls == 1 and file.stat().st_size > 8 * 300 * 20 > packed
    np.testing.assert_array_equal(cached_arrays("key", compute)["a"], np.full((300, 20), 7.0))
    assert [file.suffix for file in directory.iterdir()] == [".npz"]
    file.write_bytes(plain)
    with np.load(file) as stored:  # others can read it too
        np.testing.assert_array_equal(stored["a"], cached_arrays("key", compute)["a"])


def test_arrays_of_any_order_and_shape_come_back(directory):
    given = {
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "empty": np.zeros((0, 3)),
        "one": np.array(2.5),
        "names": np.array(["a", "bc"]),
        "mask": np.array([True, False]),
    }
    cached_arrays("key", lambda: given)
    back = cached_arrays("key", dict)
    assert list(back) == list(given)
    for name, array in given.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)
        assert back[name].flags.writeable and back[name].flags.aligned


def test_a_file_that_ends_early_or_was_overwritten_inside_is_computed_again(directory):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole.replace(b"(2, 3)", b"(1, 3)", 1))
    assert cached_arrays("key", compute)["a"].shape == (2, 3)
    file.write_bytes(whole[:40])
    assert cached_arrays("key", compute)["a"].shape == (2, 3)
    assert compute.calls == 3


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 truncated", b"no zip at all"])
def test_a_damaged_file_is_computed_again(directory, damage):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    file.write_bytes(damage)
    assert cached_arrays("key", compute)["a"][1, 2] == 5
    cached_arrays("key", compute)
    assert compute.calls == 2  # and the damaged file was replaced


def test_pickled_arrays_are_never_loaded(directory):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    np.savez(file, a=np.array([{"evil": True}], dtype=object))
    assert cached_arrays("key", compute)["a"].dtype == np.float32
    assert compute.calls == 2


def test_it_works_without_a_place_to_write(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path / "file" / "below"))
    compute = Counted()
    assert cached_arrays("key", compute)["a"].shape == (2, 3)
    assert cached_arrays("key", compute)["a"].shape == (2, 3)
    assert compute.calls == 2


def test_a_failing_replacement_leaves_nothing_behind(directory, monkeypatch):
    def refuse(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", refuse)
    assert cached_arrays("key", Counted())["a"].shape == (2, 3)
    assert list(directory.iterdir()) == []


def test_the_default_place_is_the_user_s_cache(monkeypatch):
    monkeypatch.delenv("ASG_CACHE_DIR")
    assert cache_directory().parts[-2:] == (".cache", "activestructure_gym")
