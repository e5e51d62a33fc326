"""Frames of fewer pixels, worked by hand, and a mapper that keeps its keyframes so."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.mapping.downsampling import reduced

CAMERA = PinholeCamera.from_size(8, 4)


def frame(depth: np.ndarray) -> Frame:
    rgb = np.arange(8 * 4 * 3, dtype=np.uint8).reshape(4, 8, 3)
    return Frame(rgb, np.asarray(depth, np.float32), np.eye(4), CAMERA)


def test_colours_are_means_and_depths_medians_of_returns() -> None:
    depth = np.full((4, 8), 2.0)
    depth[:2, :2] = [[1.0, 5.0], [1.1, 5.2]]  # two surfaces: the nearer one, no depth between them
    depth[:2, 2:4] = [[0.0, 3.0], [0.0, 4.0]]  # half of it has returns
    depth[:2, 4:6] = [[0.0, 3.0], [0.0, 0.0]]  # less
    depth[:2, 6:] = [[0.0, 3.0], [2.0, 4.0]]
    small = reduced(frame(depth), 2)
    assert small.depth == pytest.approx(np.array([[1.1, 3.0, 0.0, 3.0], [2.0] * 4])) and small.depth.dtype == np.float32
    assert small.rgb[0, 0].tolist() == [round((a + a + 3 + a + 24 + a + 27) / 4) for a in range(3)]
    assert small.rgb.shape == (2, 4, 3) and small.rgb.dtype == np.uint8
    assert small.camera == CAMERA.resized(4, 2)


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_blocks_are_those_of_numpy(factor: int) -> None:
    rng = np.random.default_rng(factor)
    camera = PinholeCamera.from_size(12 * factor, 7 * factor)
    shape = 7, factor, 12, factor
    rgb = rng.integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
    depth = rng.uniform(1, 9, rgb.shape[:2]).astype(np.float32) * (rng.random(rgb.shape[:2]) < 0.6)
    small = reduced(Frame(rgb, depth, np.eye(4), camera), factor)
    assert np.array_equal(small.rgb, np.rint(rgb.reshape(*shape, 3).mean(axis=(1, 3), dtype=np.float32)))
    for block, found in zip(depth.reshape(shape).transpose(0, 2, 1, 3).reshape(-1, factor**2), small.depth.ravel()):
        returns = np.sort(block[block > 0])
        assert found == (returns[(len(returns) - 1) // 2] if 2 * len(returns) >= len(block) else 0.0)


def test_a_pixel_of_a_plane_lies_on_it_to_a_pixel_of_the_large_image() -> None:
    camera = PinholeCamera.from_size(64, 36)
    slope = camera.rays() @ np.array([0.3, 0.2, 1.0])
    large = Frame(np.zeros((36, 64, 3), np.uint8), (2.0 / slope).astype(np.float32), np.eye(4), camera)
    small = reduced(large, 4)
    exact = 2.0 / (small.camera.rays() @ np.array([0.3, 0.2, 1.0]))
    assert np.abs(small.depth - exact).max() < 2.0 * np.abs(np.diff(large.depth, axis=1)).max()


def test_by_one_nothing_changes_and_no_multiple_is_refused() -> None:
    one = frame(np.ones((4, 8)))
    assert reduced(one, 1) is one
    with pytest.raises(ValueError, match="8 x 4 pixels cannot be reduced by 3"):
        reduced(one, 3)


def test_seeds_come_of_all_pixels_and_steps_see_fewer(room_frames) -> None:
    def mapped(reduction: int, iterations: int) -> tuple[Mapper, int]:
        config = MapperConfig(keyframe_reduction=reduction, iterations=iterations)
        mapper = Mapper(config, np.random.default_rng(0))
        return mapper, sum(mapper.observe(one).added for one in room_frames[:3])

    whole, small = mapped(1, 0), mapped(5, 0)
    assert small[1] == whole[1] and np.array_equal(small[0].map.means, whole[0].map.means)
    assert {one.depth.shape for one in small[0].keyframes} == {(9, 16)}
    psnr = mapped(5, 20)[0].keyframe_psnr()
    assert len(psnr) == 3 and (psnr > small[0].keyframe_psnr()).mean() > 0.5
