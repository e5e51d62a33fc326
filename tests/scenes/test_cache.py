from __future__ import annotations

import os

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.scenes.cache import (
    CACHE_VERSION,
    cache_directory,
    cache_files,
    cache_limit,
    cached_arrays,
    clear_cache,
)


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


@pytest.mark.skipif(os.name != "posix", reason="no numbers of users here")
@pytest.mark.filterwarnings("ignore:.*may have been written by another user")
def test_what_another_user_can_have_written_is_computed_again(directory):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    file.chmod(0o666)
    cached_arrays("key", compute)
    assert compute.calls == 2 and file.stat().st_mode & 0o022 == 0
    file.rename(directory / "elsewhere")
    file.symlink_to(directory / "elsewhere")
    cached_arrays("key", compute)
    assert compute.calls == 3 and not file.is_symlink()


def test_a_file_without_the_arrays_that_are_expected_is_computed_again(directory):
    compute, layout = Counted(), {"a": ("f4", 2), "b": ("f8", 0)}
    whole = cached_arrays("key", compute, layout)
    (file,) = directory.iterdir()
    for other in ({"a": whole["a"].astype(np.float64)}, {"a": whole["a"][0]}, {"b": np.float32(1.5)}):
        calls = compute.calls
        np.savez(file, **whole | other)
        assert cached_arrays("key", compute, layout)["a"].shape == (2, 3) and compute.calls == calls + 1
    np.savez(file, a=whole["a"])
    assert "b" in cached_arrays("key", compute, layout)


def test_others_can_read_a_kept_file(directory):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    with np.load(file) as stored:
        np.testing.assert_array_equal(stored["a"], cached_arrays("key", compute)["a"])
    np.savez_compressed(file, **Counted()())  # is not as it was written: computed again
    cached_arrays("key", compute)
    assert compute.calls == 2


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


def test_a_tilde_is_the_user_s_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("ASG_CACHE_DIR", "~/kept")
    assert cache_directory() == tmp_path / "kept"


def filled(keys, size=1000):
    for number, key in enumerate(keys):
        cached_arrays(key, lambda: {"a": np.full(size, 7, np.uint8)})
        for file in cache_directory().glob(f"{key}-*"):
            os.utime(file, (1e9 + number, 1e9 + number))


def names(directory):
    return sorted(file.name.partition("-")[0] for file in directory.iterdir())


def test_a_flipped_bit_anywhere_is_noticed_and_mended(directory):
    """Apart from the fields of a zip file that say nothing about the arrays, such as dates."""
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    whole = file.read_bytes()
    for position in range(len(whole)):
        calls = compute.calls
        file.write_bytes(whole[:position] + bytes([whole[position] ^ 0x10]) + whole[position + 1 :])
        back = cached_arrays("key", compute)
        assert list(back) == ["a", "b"] and float(back["b"]) == 1.5
        np.testing.assert_array_equal(back["a"], np.arange(6).reshape(2, 3))
        if compute.calls > calls:
            assert file.read_bytes()[:2] == b"PK"
            cached_arrays("key", compute)
            assert compute.calls == calls + 1


def test_flipped_numbers_are_not_used(directory):
    compute = Counted()
    cached_arrays("key", compute)
    (file,) = directory.iterdir()
    file.write_bytes(file.read_bytes().replace(np.float32(4).tobytes(), np.float32(5).tobytes(), 1))
    np.testing.assert_array_equal(cached_arrays("key", compute)["a"], np.arange(6).reshape(2, 3))
    assert compute.calls == 2


def test_it_keeps_below_its_size_and_what_was_used_last(directory, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_MAX", "4 kB")
    filled("abc")
    cached_arrays("a", dict)  # used, and so the youngest
    filled("d")
    assert names(directory) == ["a", "c", "d"]
    cached_arrays("large", lambda: {"a": np.zeros(9000, np.uint8)})
    assert names(directory) == ["large"]  # the one that was just written stays
    assert sum(size for _, size in cache_files()) == (directory / f"large-v{CACHE_VERSION}.npz").stat().st_size


def test_a_file_that_is_read_stays(directory, monkeypatch):
    import fcntl

    filled("ab")
    with open(directory / f"a-v{CACHE_VERSION}.npz", "rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_SH)
        assert clear_cache() == (1, 1270) or clear_cache()[0] == 0
        assert names(directory) == ["a"]
    assert clear_cache()[0] == 1 and names(directory) == []


def test_what_dead_processes_left_is_removed(directory):
    filled("a")
    (directory / ".old.npz.1.tmp").touch()
    os.utime(directory / ".old.npz.1.tmp", (1e9, 1e9))
    (directory / ".new.npz.2.tmp").touch()
    (directory / "thesis.tex").touch()
    clear_cache()
    assert sorted(file.name for file in directory.iterdir()) == [".new.npz.2.tmp", "thesis.tex"]


def test_nothing_is_kept_where_the_size_is_0(directory, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_MAX", "0")
    filled("a")
    assert not directory.exists()


@pytest.mark.parametrize(
    "text, size", [("", 4 << 30), ("1GiB", 1 << 30), ("1.5 kb", 1536), ("500M", 500 << 20), ("7", 7), ("2TB", 2 << 40)]
)
def test_sizes(text, size, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_MAX", text)
    assert cache_limit() == size


@pytest.mark.parametrize("text", ["much", "-1", "1e9", "9" * 100, "1 PB", "nan"])
def test_a_size_that_is_none_is_refused(text, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_MAX", text)
    with pytest.raises(InputError, match="ASG_CACHE_MAX is a size such as 500MB"):
        cache_limit()
