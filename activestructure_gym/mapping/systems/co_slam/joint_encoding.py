"""Define the neural field of Co-SLAM: signed distance and colour of a point from a hash grid and a one-blob encoding.

Encodings, decoders, rendering and losses follow [co_slam, code], in plain torch and sized for a CPU. Distances are in
units of the truncation distance: 1 in free space, 0 on the surface, negative behind it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import embedding_bag

_PRIMES = (1, 2654435761 - 2**32, 805459861)  # factors of the hash function ([ngp, eq. 4]), in 32 bits
_START = 1e-4  # largest absolute value of the initial features of the grid ([ngp])
FEATURES = 2  # features per grid vertex and level
BINS = 16  # bins of the one-blob encoding per coordinate
GEOMETRY = 15  # outputs of the distance decoder that are inputs of the colour decoder
HIDDEN = 32  # units of the hidden layer of a decoder


class HashGrid(nn.Module):
    """Interpolate features of points [n, 3] in 0..1 trilinearly in grids of several resolutions ([ngp], Sec. 3).

    ``levels`` grids have ``coarsest`` to ``finest`` cells per side. The features of a grid are in a table of at most
    2^``log2_entries`` rows.
    """

    def __init__(self, levels: int, coarsest: int, finest: int, log2_entries: int, rng: torch.Generator) -> None:
        super().__init__()
        self.resolutions = level_resolutions(levels, coarsest, finest)
        self.entries = 2**log2_entries
        sizes = [min(self.entries, (resolution + 1) ** 3) for resolution in self.resolutions]
        self.tables = nn.ParameterList(
            nn.Parameter((2.0 * torch.rand((size, FEATURES), generator=rng) - 1.0) * _START) for size in sizes
        )

    def forward(self, points: torch.Tensor) -> torch.Tensor:  # [n, 3] -> [n, levels * 2]
        """Return the features of all levels, concatenated."""
        found = []
        for resolution, table in zip(self.resolutions, self.tables):
            index, weight = corners(points, resolution, self.entries)
            found.append(_WeightedRows.apply(table, index, weight))
        return torch.cat(found, dim=1)


def level_resolutions(levels: int, coarsest: int, finest: int) -> list[int]:
    """Return the number of cells per side of every level, a geometric series ([ngp, eq. 2 and 3]).

    The series has ``levels`` terms from ``coarsest`` to ``finest`` cells.
    """
    growth = (finest / coarsest) ** (1.0 / max(1, levels - 1))
    return [int(np.floor(coarsest * growth**level + 1e-9)) for level in range(levels)]


def corners(
    points: torch.Tensor,  # [n, 3] 0..1
    resolution: int,  # cells per side of the level
    entries: int,  # largest number of rows of the level's table
) -> tuple[torch.Tensor, torch.Tensor]:  # [n, 8] int32 rows of the level's table, [n, 8] weights that sum to 1
    """Return table rows and trilinear weights of the eight grid vertices around each point.

    If the table has fewer rows than the grid has vertices, the rows are hashed.
    """
    scaled = points.clamp(0.0, 1.0).T * resolution
    low = scaled.floor().clamp(max=resolution - 1)
    share, cell = scaled - low, low.int()
    dense = (resolution + 1) ** 3 <= entries
    factors = (1, resolution + 1, (resolution + 1) ** 2) if dense else _PRIMES
    # Only the low bits are used, so integer overflow of the products has no effect.
    part = [[(cell[axis] + step) * factors[axis] for step in (0, 1)] for axis in range(3)]
    side = [[1.0 - share[axis], share[axis]] for axis in range(3)]
    rows, weights = [], []
    for corner in range(8):
        x, y, z = ((corner >> axis) & 1 for axis in range(3))
        one, two, three = part[0][x], part[1][y], part[2][z]
        rows.append(one + two + three if dense else (one ^ two ^ three) & (entries - 1))
        weights.append(side[0][x] * side[1][y] * side[2][z])
    return torch.stack(rows, dim=1), torch.stack(weights, dim=1)


class _WeightedRows(torch.autograd.Function):
    """Compute weighted sums of table rows, with a backward pass that is much faster than torch's.

    Only the table gets a gradient.
    """

    @staticmethod
    def forward(ctx: Any, table: torch.Tensor, index: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Return the weighted sums [n, 2] of the rows ``index`` [n, 8] with ``weight`` [n, 8]."""
        ctx.save_for_backward(index, weight)
        ctx.rows = len(table)
        return embedding_bag(index, table, per_sample_weights=weight, mode="sum")

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:  # type: ignore[override]
        """Return the gradient of the table, and None for index and weights."""
        index, weight = ctx.saved_tensors
        rows, shares = index.reshape(-1).numpy(), weight[..., None] * gradient[:, None]
        sums = [np.bincount(rows, shares[..., k].reshape(-1).numpy(), minlength=ctx.rows) for k in range(FEATURES)]
        return torch.from_numpy(np.stack(sums, axis=1)).to(gradient), None, None


def one_blob(points: torch.Tensor) -> torch.Tensor:  # [n, 3] 0..1 -> [n, 3 * 16]
    """Return the one-blob encoding of points: each coordinate as a Gaussian, sampled at 16 bins.

    The standard deviation of the Gaussian is one bin width. Source: [muller2019], Sec. 4.3.
    """
    middles = (torch.arange(BINS, dtype=points.dtype) + 0.5) / BINS
    return torch.exp(-0.5 * ((points[..., None] - middles) * BINS) ** 2).flatten(1)


class JointField(nn.Module):
    """Compute signed distance and colour of points in a box from both encodings; arguments as in `HashGrid`."""

    def __init__(self, levels: int, coarsest: int, finest: int, log2_entries: int, rng: torch.Generator) -> None:
        super().__init__()
        self.grid = HashGrid(levels, coarsest, finest, log2_entries, rng)
        blobs = 3 * BINS
        self.distance = _decoder(levels * FEATURES + blobs, 1 + GEOMETRY, rng)
        self.color = _decoder(blobs + GEOMETRY, 3, rng)

    def forward(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:  # [n, 3] 0..1 -> [n], [n, 3]
        """Return distances in units of the truncation distance, and colours in 0..1."""
        blobs = one_blob(points)
        found = self.distance(torch.cat([self.grid(points), blobs], dim=1))
        return found[:, 0], torch.sigmoid(self.color(torch.cat([blobs, found[:, 1:]], dim=1)))


def _decoder(inputs: int, outputs: int, rng: torch.Generator) -> nn.Sequential:
    layers = nn.Linear(inputs, HIDDEN, bias=False), nn.ReLU(), nn.Linear(HIDDEN, outputs, bias=False)
    for layer in (layers[0], layers[2]):
        bound = 1.0 / np.sqrt(layer.in_features)  # torch's own initialisation, but with the given generator
        layer.weight.data = (2.0 * torch.rand(layer.weight.shape, generator=rng) - 1.0) * bound
    return nn.Sequential(*layers)


def ray_weights(
    distances: torch.Tensor,  # [r, s] in units of the truncation distance
    depths: torch.Tensor,  # [r, s] metres, rising
    truncation: float,  # metres, truncation distance t
) -> torch.Tensor:  # [r, s], sums to 1
    """Return the weight of each of s samples of a ray: sigmoid(d / t) sigmoid(-d / t), normalised to a sum of 1.

    d is the distance in units of the truncation distance t ([co_slam, code]). The weight is 0 beyond t behind the first
    sign change of d, or behind the first sample of a ray without a sign change.
    """
    weights = torch.sigmoid(distances / truncation) * torch.sigmoid(-distances / truncation)
    changes = distances[:, 1:] * distances[:, :-1] < 0.0
    first = changes.to(torch.uint8).argmax(dim=1, keepdim=True)
    weights = weights * (depths < depths.gather(1, first) + truncation)
    return weights / (weights.sum(dim=1, keepdim=True) + 1e-8)


def distance_losses(
    distances: torch.Tensor,  # [r, s] in units of the truncation distance
    depths: torch.Tensor,  # [r, s] metres
    measured: torch.Tensor,  # [r] metres, 0 = no return
    truncation: float,  # metres, truncation distance t
) -> tuple[torch.Tensor, torch.Tensor]:  # loss near the surface in m^2, loss in free space
    """Return two losses of the distances d at the samples of r rays ([co_slam, code]).

    A sample has depth z, and its ray the measured depth D. The first loss sums (z + d t - D)^2 over samples near the
    surface (|z - D| <= t). The second loss sums (d - 1)^2 over samples in free space (z < D - t). Both are divided by
    the number of all samples, and multiplied by the share of the samples of the other kind.
    """
    target = measured[:, None]
    before = depths < target - truncation
    near = ~before & (depths <= target + truncation) & (target > 0.0)
    free, close = int(before.sum()), int(near.sum())
    count = max(1, free + close)
    by_surface = (((depths + distances * truncation - target) * near) ** 2).mean() * (free / count)
    by_free = (((distances - 1.0) * before) ** 2).mean() * (close / count)
    return by_surface, by_free
