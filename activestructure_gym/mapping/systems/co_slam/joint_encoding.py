"""Define Co-SLAM's field: signed distance and colour of a point from a hash grid and one-blob encoding.

Joint encoding, decoders, rendering and losses follow [co_slam, code], in plain torch and sized for a CPU. Distances are
in units of the truncation: 1 in free space, 0 on the surface, negative behind it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import embedding_bag

_PRIMES = (1, 2654435761 - 2**32, 805459861)  # primes of the hash ([ngp, eq. 4]), in 32 bits
_START = 1e-4  # largest absolute value of initial features ([ngp])
FEATURES = 2  # features per level
BINS = 16  # bins of the one-blob encoding per coordinate
GEOMETRY = 15  # outputs of the distance decoder that the colour decoder uses
HIDDEN = 32  # width of the hidden layer


class HashGrid(nn.Module):
    """Interpolate features of points [n, 3] in 0..1 trilinearly in grids of several resolutions ([ngp], Sec. 3)."""

    def __init__(self, levels: int, coarsest: int, finest: int, log2_entries: int, rng: torch.Generator) -> None:
        super().__init__()
        self.resolutions = level_resolutions(levels, coarsest, finest)
        self.entries = 2**log2_entries
        sizes = [min(self.entries, (resolution + 1) ** 3) for resolution in self.resolutions]
        self.tables = nn.ParameterList(
            nn.Parameter((2.0 * torch.rand((size, FEATURES), generator=rng) - 1.0) * _START) for size in sizes
        )

    def forward(self, points: torch.Tensor) -> torch.Tensor:  # [n, 3] -> [n, levels * 2]
        """Return the concatenated features of all levels."""
        found = []
        for resolution, table in zip(self.resolutions, self.tables):
            index, weight = corners(points, resolution, self.entries)
            found.append(_WeightedRows.apply(table, index, weight))
        return torch.cat(found, dim=1)


def level_resolutions(levels: int, coarsest: int, finest: int) -> list[int]:
    """Return the cells per side of every level, a geometric series ([ngp, eq. 2 and 3])."""
    growth = (finest / coarsest) ** (1.0 / max(1, levels - 1))
    return [int(np.floor(coarsest * growth**level + 1e-9)) for level in range(levels)]


def corners(
    points: torch.Tensor,  # [n, 3] 0..1
    resolution: int,
    entries: int,
) -> tuple[torch.Tensor, torch.Tensor]:  # [n, 8] int32 rows of the level's table, [n, 8] weights that sum to 1
    """Return table rows and weights of the eight corners around each point; hashed if the table is too small."""
    scaled = points.clamp(0.0, 1.0).T * resolution
    low = scaled.floor().clamp(max=resolution - 1)
    share, cell = scaled - low, low.int()
    dense = (resolution + 1) ** 3 <= entries
    factors = (1, resolution + 1, (resolution + 1) ** 2) if dense else _PRIMES
    # Only the low bits are used, so an overflow of the products has no effect.
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
    """Compute weighted sums of table rows, differentiable by the table only; much faster than torch's backward."""

    @staticmethod
    def forward(ctx: Any, table: torch.Tensor, index: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Return the sums [n, 2] for ``index`` and ``weight`` [n, 8]."""
        ctx.save_for_backward(index, weight)
        ctx.rows = len(table)
        return embedding_bag(index, table, per_sample_weights=weight, mode="sum")

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> Any:  # type: ignore[override]
        """Return the derivative by the table; None for index and weights."""
        index, weight = ctx.saved_tensors
        rows, shares = index.reshape(-1).numpy(), weight[..., None] * gradient[:, None]
        sums = [np.bincount(rows, shares[..., k].reshape(-1).numpy(), minlength=ctx.rows) for k in range(FEATURES)]
        return torch.from_numpy(np.stack(sums, axis=1)).to(gradient), None, None


def one_blob(points: torch.Tensor) -> torch.Tensor:  # [n, 3] 0..1 -> [n, 3 * 16]
    """Return each coordinate as a Gaussian of one bin width, sampled at 16 bin centres ([muller2019], Sec. 4.3)."""
    middles = (torch.arange(BINS, dtype=points.dtype) + 0.5) / BINS
    return torch.exp(-0.5 * ((points[..., None] - middles) * BINS) ** 2).flatten(1)


class JointField(nn.Module):
    """Model distance and colour in a box; the arguments are those of `HashGrid`."""

    def __init__(self, levels: int, coarsest: int, finest: int, log2_entries: int, rng: torch.Generator) -> None:
        super().__init__()
        self.grid = HashGrid(levels, coarsest, finest, log2_entries, rng)
        blobs = 3 * BINS
        self.distance = _decoder(levels * FEATURES + blobs, 1 + GEOMETRY, rng)
        self.color = _decoder(blobs + GEOMETRY, 3, rng)

    def forward(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:  # [n, 3] 0..1 -> [n], [n, 3]
        """Return distances in units of the truncation, and colours 0..1."""
        blobs = one_blob(points)
        found = self.distance(torch.cat([self.grid(points), blobs], dim=1))
        return found[:, 0], torch.sigmoid(self.color(torch.cat([blobs, found[:, 1:]], dim=1)))


def _decoder(inputs: int, outputs: int, rng: torch.Generator) -> nn.Sequential:
    layers = nn.Linear(inputs, HIDDEN, bias=False), nn.ReLU(), nn.Linear(HIDDEN, outputs, bias=False)
    for layer in (layers[0], layers[2]):
        bound = 1.0 / np.sqrt(layer.in_features)  # torch's initialisation, with our generator
        layer.weight.data = (2.0 * torch.rand(layer.weight.shape, generator=rng) - 1.0) * bound
    return nn.Sequential(*layers)


def ray_weights(
    distances: torch.Tensor,  # [r, s] in units of the truncation
    depths: torch.Tensor,  # [r, s] metres, rising
    truncation: float,  # metres
) -> torch.Tensor:  # [r, s], sums to 1
    """Return the weight of every sample of a ray: sigmoid(d / t) sigmoid(-d / t), up to t behind the first sign change.

    d is in units of the truncation t ([co_slam, code]). A ray without a sign change ends t behind its first sample.
    """
    weights = torch.sigmoid(distances / truncation) * torch.sigmoid(-distances / truncation)
    changes = distances[:, 1:] * distances[:, :-1] < 0.0
    first = changes.to(torch.uint8).argmax(dim=1, keepdim=True)
    weights = weights * (depths < depths.gather(1, first) + truncation)
    return weights / (weights.sum(dim=1, keepdim=True) + 1e-8)


def distance_losses(
    distances: torch.Tensor,  # [r, s] in units of the truncation
    depths: torch.Tensor,  # [r, s] metres
    measured: torch.Tensor,  # [r] metres, 0 = no return
    truncation: float,  # metres
) -> tuple[torch.Tensor, torch.Tensor]:  # near the surface, in free space
    """Return the mean squares of z + d t - D within t of the measured depth D, and of d - 1 in front of it.

    z is the depth of a sample, d its distance, t the truncation. Both means are over all samples, and each is weighted
    by the share of the other kind of samples ([co_slam, code]).
    """
    target = measured[:, None]
    before = depths < target - truncation
    near = ~before & (depths <= target + truncation) & (target > 0.0)
    free, close = int(before.sum()), int(near.sum())
    count = max(1, free + close)
    by_surface = (((depths + distances * truncation - target) * near) ** 2).mean() * (free / count)
    by_free = (((distances - 1.0) * before) ** 2).mean() * (close / count)
    return by_surface, by_free
