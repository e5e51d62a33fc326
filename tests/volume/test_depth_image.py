import numpy as np
from scipy import ndimage

from activestructure_gym.volume.depth_image import fill_gaps, minimum_pyramid, solid_gaps


def test_minimum_pyramid_holds_block_minima():
    depth = np.random.default_rng(4).random((45, 70)).astype(np.float32)
    values, levels = minimum_pyramid(depth)
    assert len(levels) > 2
    for number, (start, height, width) in enumerate(levels):
        level = values[start : start + height * width].reshape(height, width)
        size = 2**number
        for row, column in [(0, 0), (height - 1, width - 1), (height // 2, width // 3)]:
            block = depth[row * size : (row + 1) * size, column * size : (column + 1) * size]
            assert level[row, column] == block.min()


def test_solid_gaps_are_the_opening_of_what_is_lost():
    rng = np.random.default_rng(0)
    for _ in range(5):
        depth = (ndimage.uniform_filter(rng.random((40, 60)), 9) > 0.5).astype(np.float32)
        lost = np.pad(depth <= 0, 5, constant_values=True)
        oracle = ndimage.binary_opening(lost, np.ones((5, 5)))[5:-5, 5:-5]
        gaps = solid_gaps(depth)
        assert not (gaps & (depth > 0)).any()
        inner = (slice(4, -4),) * 2  # at the border the oracle's padding opens, too
        np.testing.assert_array_equal(gaps[inner], oracle[inner])
        assert 0 < gaps.sum() < lost.sum()


def test_what_a_pixel_without_return_proves():
    depth = np.full((20, 20), 3.0, np.float32)
    depth[5, 5] = 0.0  # one lost pixel, with a near neighbour
    depth[5, 6] = 1.0
    depth[10:16, 10:16] = 0.0  # nothing there
    assert fill_gaps(depth, None, dropouts=False) is depth
    np.testing.assert_array_equal(fill_gaps(depth, 10.0, dropouts=False), np.where(depth > 0, depth, 10.0))
    filled = fill_gaps(depth, 10.0, dropouts=True)
    assert filled[5, 5] == 1.0 and (filled[10:16, 10:16] == 10.0).all()
    blind = fill_gaps(depth, None, dropouts=True)
    assert blind[5, 5] == 1.0 and (blind[11:15, 11:15] == 0.0).all() and blind[10, 12] == 3.0
