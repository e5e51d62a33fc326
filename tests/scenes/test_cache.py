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
