from __future__ import annotations

import struct

import numpy as np
import pytest

from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.gaussian_map import ROWS
from activestructure_gym.mapping.splat_file import write_splat


@pytest.fixture
def gaussians(rng) -> GaussianMap:
    block = rng.normal(size=(ROWS, 50)).astype(np.float32)
    block[7:10] = rng.uniform(-5, -1, (3, 50))
    block[11:14] = rng.uniform(-0.2, 1.2, (3, 50))
    result = GaussianMap(50)
    result.append(block)
    return result


def test_the_bytes_of_one_gaussian(tmp_path):
    """By hand: a ball of 5 cm at (1, 2, 3), half opaque, red with a little more than none of blue, turned by a half
    turn about x."""
    one = GaussianMap(1)
    one.append(np.array([[1, 2, 3, 0, 2, 0, 0, *[np.log(0.05)] * 3, 0.0, 1.0, -0.3, 0.1]]).T)
    write_splat(one, tmp_path / "one.splat")
    data = (tmp_path / "one.splat").read_bytes()
    assert len(data) == 32
    assert struct.unpack("<6f", data[:24]) == pytest.approx((1, 2, 3, 0.05, 0.05, 0.05))
    assert tuple(data[24:28]) == (255, 0, 26, 128)
    assert tuple(data[28:]) == (128, 255, 128, 128)


def test_everything_is_found_again_and_the_largest_come_first(gaussians, tmp_path):
    write_splat(gaussians, tmp_path / "map.splat")
    rows = np.frombuffer((tmp_path / "map.splat").read_bytes(), np.uint8).reshape(-1, 32)
    floats = rows[:, :24].copy().view("<f4")
    weight = gaussians.opacities * gaussians.scales.prod(axis=1)
    order = np.argsort(-weight)
    np.testing.assert_array_equal(floats[:, :3], gaussians.means[order])
    np.testing.assert_allclose(floats[:, 3:], gaussians.scales[order], rtol=1e-6)
    np.testing.assert_allclose(rows[:, 24:27] / 255.0, np.clip(gaussians.colors[order], 0, 1), atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(rows[:, 27] / 255.0, gaussians.opacities[order], atol=0.5 / 255 + 1e-6)
    read = (rows[:, 28:].astype(float) - 128) / 128
    cosine = np.abs((read * gaussians.quaternions[order]).sum(axis=1)) / np.linalg.norm(read, axis=1)
    assert np.degrees(2 * np.arccos(np.minimum(cosine, 1))).max() < 1.0


def test_a_disk_that_is_full_leaves_what_was_there(gaussians, tmp_path, monkeypatch):
    out = tmp_path / "map.splat"
    out.write_bytes(b"before")
    monkeypatch.setattr("os.replace", lambda *names: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        write_splat(gaussians, out)
    assert out.read_bytes() == b"before" and list(tmp_path.iterdir()) == [out]
