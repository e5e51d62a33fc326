"""npz files that are what they seem, and others."""

from __future__ import annotations

import io
import os
import zipfile

import numpy as np
import pytest

from activestructure_gym.npz import read_npz, write_npz


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array)
    return stream.getvalue()


def zipped(path, **members: bytes):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_wrote_is_read(save, tmp_path):
    content = {
        "a": np.arange(12.0).reshape(3, 4), "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "none": np.zeros((0, 3)), "one": np.array(0.5), "flags": np.array([True, False]),
        "names": np.array(["x", "yz"]), "swapped": np.arange(3, dtype=">i4"),
    }  # fmt: skip
    save(tmp_path / "a.npz", **content)
    found = read_npz(tmp_path / "a.npz")
    assert list(found) == list(content)
    for name, array in content.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)
        assert found[name].flags.writeable


def bomb(path):
    return zipped(path, a=npy(np.zeros(100 << 20, np.uint8)))


def lying_header(path):
    return zipped(path, a=npy(np.zeros(3)).replace(b"(3,)", b"(9,)"))


def objects(path):
    np.savez(path, a=np.array([{}], object))
    return path


def damaged(path):
    np.savez(path, a=np.arange(1000))
    content = bytearray(path.read_bytes())
    content[500] ^= 1
    path.write_bytes(content)
    return path


def cut(path):
    np.savez(path, a=np.arange(1000))
    path.write_bytes(path.read_bytes()[:-30])
    return path


def pipe(path):
    os.mkfifo(path)
    return path


@pytest.mark.parametrize(
    "make, words",
    [
        (bomb, "unpack to 104,857,728, more than 200 times as many"),
        (lying_header, "'a.npy' does not have the size given in its header"),
        (objects, "allow_pickle"),
        (damaged, "Bad CRC-32"),
        (cut, "not a zip file"),
        (lambda path: zipped(path, a=b"no array"), "magic"),
        (lambda path: zipped(path, **{str(n): npy(np.zeros(1)) for n in range(1001)}), "1001 arrays"),
        (lambda path: path.write_bytes(npy(np.zeros(3))) and path, "not a zip file"),
        (pipe, "not a regular file"),
    ],
)
def test_anything_else_is_refused_in_a_sentence(make, words, tmp_path):
    with pytest.raises(ValueError, match=words) as error:
        read_npz(make(tmp_path / "a.npz"))
    assert len(str(error.value).splitlines()) == 1


def test_what_packs_too_well_to_be_believed_is_written_as_it_is(tmp_path):
    blank = {"pictures": np.zeros((8, 2048, 2048, 3), np.uint8), "psnr": np.ones(8)}  # of a map that shows nothing
    write_npz(tmp_path / "blank.npz", blank)
    found = read_npz(tmp_path / "blank.npz")
    assert found["pictures"].shape == blank["pictures"].shape and not found["pictures"].any()
    write_npz(tmp_path / "small.npz", {"zeros": np.zeros(10**6)})
    assert (tmp_path / "small.npz").stat().st_size < 100_000 and len(read_npz(tmp_path / "small.npz")["zeros"]) == 10**6
