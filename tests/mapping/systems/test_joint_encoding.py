"""The parts of Co-SLAM's field by hand: one-blobs, hash grid and its derivative, weights along a ray, losses."""

import numpy as np
import pytest
import torch

from activestructure_gym.mapping.systems.co_slam.joint_encoding import (
    HashGrid,
    JointField,
    corners,
    distance_losses,
    level_resolutions,
    one_blob,
    ray_weights,
)


def _random(seed=0):
    return torch.Generator().manual_seed(seed)


def test_levels_are_a_geometric_series():
    assert level_resolutions(3, 16, 64) == [16, 32, 64]
    assert level_resolutions(1, 16, 64) == [16]


def test_a_blob_is_a_gaussian_as_wide_as_a_bin():
    """x = .5 lies between bins 7 and 8, half a bin from either middle: exp(-1/8), then exp(-9/8)."""
    blobs = one_blob(torch.tensor([[0.5, 0.0, 1.0]], dtype=torch.float64)).reshape(3, 16)
    assert blobs[0, 6:10].tolist() == pytest.approx(np.exp([-9 / 8, -1 / 8, -1 / 8, -9 / 8]))
    assert (int(blobs[1].argmax()), int(blobs[2].argmax())) == (0, 15)


def test_corners_of_a_level_that_fits():
    """At (.25, .5, 1) of 2 cells a side: halfway between 0 and 1 in x, at 1 in y, at the end in z."""
    rows, weights = corners(torch.tensor([[0.25, 0.5, 1.0]]), 2, 27)
    found = {}
    for row, weight in zip(rows[0].tolist(), weights[0].tolist()):
        found[row] = found.get(row, 0.0) + weight
    assert {row: w for row, w in found.items() if w} == {0 + 3 * 1 + 9 * 2: 0.5, 1 + 3 * 1 + 9 * 2: 0.5}


def test_corners_that_do_not_fit_are_hashed():
    """The published hash in whole numbers of any size: x ^ y 2654435761 ^ z 805459861, modulo the table."""
    points = torch.rand((50, 3), generator=_random())
    rows, weights = corners(points, 100, 256)
    low = np.floor(points.numpy() * np.float32(100)).astype(int)
    for n in range(50):
        for corner in range(8):
            x, y, z = low[n] + [corner & 1, corner >> 1 & 1, corner >> 2]
            assert int(rows[n, corner]) == (int(x) ^ int(y) * 2654435761 ^ int(z) * 805459861) % 256
    assert weights.sum(dim=1).numpy() == pytest.approx(np.ones(50), abs=1e-5)


def test_a_linear_function_is_kept():
    """Trilinear interpolation of x + 2 y - z at the corners is the function itself."""
    grid = HashGrid(1, 4, 4, 8, _random())
    index = np.arange(5)
    x, y, z = np.meshgrid(index, index, index, indexing="ij")
    table = np.zeros((125, 2), np.float32)
    table[(x + 5 * (y + 5 * z)).ravel(), 1] = ((x + 2 * y - z) / 4).ravel()
    grid.tables[0].data = torch.from_numpy(table)
    points = torch.rand((40, 3), generator=_random(1))
    assert grid(points)[:, 1].detach().numpy() == pytest.approx((points @ torch.tensor([1.0, 2, -1])).numpy(), abs=1e-5)


def test_the_derivative_of_the_tables_is_torch_s():
    grid = HashGrid(2, 4, 32, 8, _random())
    points, pull = torch.rand((60, 3), generator=_random(1)), torch.rand((60, 4), generator=_random(2))
    (grid(points) * pull).sum().backward()
    for level, (resolution, table) in enumerate(zip(grid.resolutions, grid.tables)):
        leaf = table.detach().clone().requires_grad_()
        rows, weights = corners(points, resolution, 256)
        ((leaf[rows.long()] * weights[..., None]).sum(dim=1) * pull[:, 2 * level : 2 * level + 2]).sum().backward()
        assert table.grad.numpy() == pytest.approx(leaf.grad.numpy(), abs=1e-5) and leaf.grad.any()


def test_weights_stand_at_the_first_surface():
    """Signs change after the third sample: what lies more than the truncation behind it counts nothing."""
    depths = torch.tensor([[1.0, 1.1, 1.2, 1.25, 1.29, 1.35, 1.5]])
    distances = torch.tensor([[1.0, 0.5, 0.1, -0.1, -0.5, 0.0, 0.1]])
    weights = ray_weights(distances, depths, 0.1)[0]
    bell = 1 / (1 + np.exp(-distances[0].numpy() / 0.1)) / (1 + np.exp(distances[0].numpy() / 0.1))
    bell[5:] = 0.0  # 1.2 + .1 is before 1.35
    assert weights.tolist() == pytest.approx(bell / bell.sum(), abs=1e-6)
    assert float(weights.sum()) == pytest.approx(1.0)


def test_the_losses_by_hand():
    """Measured 2 m, truncation .1 m: two samples are free, two near, one too far behind; a ray without a return."""
    depths = torch.tensor([[1.0, 1.8, 1.95, 2.05, 2.5], [1.0, 1.1, 1.2, 1.3, 1.4]])
    distances = torch.tensor([[0.5, 1.0, 0.5, -0.3, 9.0], [9.0, 9.0, 9.0, 9.0, 9.0]])
    near, free = distance_losses(distances, depths, torch.tensor([2.0, 0.0]), 0.1)
    assert float(near) == pytest.approx((0.0**2 + 0.02**2) / 10 * (2 / 4), abs=1e-9)
    assert float(free) == pytest.approx(0.5**2 / 10 * (2 / 4))


def test_same_generator_same_field():
    fields = [JointField(2, 4, 8, 8, _random(5)) for _ in range(2)]
    points = torch.rand((9, 3), generator=_random())
    assert torch.equal(fields[0](points)[0], fields[1](points)[0])
    assert fields[0](points)[1].min() >= 0 and fields[0](points)[1].max() <= 1
