"""Render Gaussians in plain torch, as the baseline of the rasteriser benchmark.

The code is optimised for a CPU. Tiles have 8 x 8 pixels. The box of a Gaussian depends on its opacity. A batch fits the
cache and holds tiles with similar numbers of Gaussians. Transmittance is computed as a sum of logarithms, which is a
fifth faster than a product, because the derivative of a product needs a division. The image equals that of the other
backends.
"""

from __future__ import annotations

import math

import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting.reference import MIN_ALPHA, MIN_TRANSMITTANCE, NEAR_PLANE, project_gaussians

_TILE = 8  # side of a tile in pixels
_PAIRS_AT_ONCE = 500_000  # largest number of (pixel, Gaussian) pairs in a batch
_MIN_LOG = math.log(MIN_TRANSMITTANCE)  # compositing ends below this logarithm of the transmittance


def rasterize_torch_tiles(
    means: torch.Tensor,  # [N, 3] metres, world frame
    quaternions: torch.Tensor,  # [N, 4] wxyz
    log_scales: torch.Tensor,  # [N, 3] logarithms of metres
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor,  # [N, 3]
    camera_from_world: torch.Tensor,  # [4, 4]
    camera: PinholeCamera,
    *,
    max_alpha: float = 0.999,  # upper limit of the alpha of a Gaussian at a pixel
    with_color: bool = True,
) -> torch.Tensor:  # [H, W, 5] colour, accumulated depth, alpha; [H, W, 2] without colour
    """Render N Gaussians from one camera; the result is differentiable by autograd."""
    position, inverse, depth = project_gaussians(means, quaternions, log_scales, camera_from_world, camera)
    opacity = torch.sigmoid(opacity_logits)
    tiles_x, tiles_y = -(-camera.width // _TILE), -(-camera.height // _TILE)
    tile, splat = _entries(position, inverse, depth, opacity, tiles_x, tiles_y)
    features = torch.stack([depth, torch.ones_like(depth)], dim=1)
    if with_color:
        features = torch.cat([colors, features], dim=1)  # [N, 5]
    packed = torch.cat([position, inverse, opacity[:, None], features], dim=1)  # [N, 11] or [N, 8]

    counts = torch.bincount(tile, minlength=tiles_x * tiles_y)
    starts = torch.cumsum(counts, dim=0) - counts
    by_length = torch.argsort(counts, descending=True)
    by_length = by_length[counts[by_length] > 0]
    inside = torch.arange(_TILE * _TILE)
    output = torch.zeros(tiles_y * _TILE, tiles_x * _TILE, features.shape[1])
    at = 0
    while at < len(by_length):
        length = int(counts[by_length[at]])
        batch = by_length[at : at + max(1, _PAIRS_AT_ONCE // (length * _TILE * _TILE))]
        at += len(batch)
        slots = torch.arange(length)
        place = (starts[batch, None] + slots).clamp_max(len(splat) - 1)
        own = packed[splat[place]]  # [B, K, 11 or 8]
        u = (batch % tiles_x)[:, None] * _TILE + inside % _TILE
        v = (batch // tiles_x)[:, None] * _TILE + inside // _TILE
        dx = (u + 0.5)[:, None, :] - own[..., 0:1]  # [B, K, 64]
        dy = (v + 0.5)[:, None, :] - own[..., 1:2]
        power = -0.5 * (own[..., 2:3] * dx * dx + own[..., 4:5] * dy * dy) - own[..., 3:4] * dx * dy
        alpha = (own[..., 5:6] * torch.exp(power)).clamp_max(max_alpha)
        real = (slots < counts[batch, None])[..., None] & (alpha.detach() >= MIN_ALPHA)
        alpha = torch.where(real, alpha, torch.zeros(()))
        passes = torch.log1p(-alpha)
        after = torch.cumsum(passes, dim=1)
        weight = alpha * torch.exp(after - passes) * (after.detach() > _MIN_LOG)
        output = output.index_put((v, u), torch.einsum("bkp,bkc->bpc", weight, own[..., 6:]))
    return output[: camera.height, : camera.width]


def _entries(position, inverse, depth, opacity, tiles_x, tiles_y):
    """Return the tile index and the Gaussian index of every pair (tile, Gaussian) in which the Gaussian's box overlaps.

    The pairs are ordered by tile, and within a tile by depth. ``position`` [N, 2] is in pixels, ``inverse`` [N, 3] has
    the entries xx, xy, yy of the inverse image covariance, ``depth`` [N] is in metres, ``opacity`` [N] is in 0..1. The
    image has ``tiles_x`` x ``tiles_y`` tiles.
    """
    with torch.no_grad():
        extent = 2.0 * torch.log((opacity / MIN_ALPHA).clamp_min(1e-30))
        determinant = inverse[:, 0] * inverse[:, 2] - inverse[:, 1] ** 2
        radius = torch.sqrt(extent.clamp_min(0.0)[:, None] * inverse[:, [2, 0]] / determinant[:, None])
        limits = torch.tensor([tiles_x, tiles_y])
        low = torch.minimum(((position - radius) / _TILE).floor().long().clamp_min(0), limits)
        high = torch.minimum(((position + radius) / _TILE).floor().long().clamp_min(-1) + 1, limits)
        size = (high - low).clamp_min(0)
        count = torch.where((depth >= NEAR_PLANE) & (extent >= 0), size[:, 0] * size[:, 1], 0)
        order = torch.argsort(depth, stable=True)
        splat = torch.repeat_interleave(order, count[order])
        first = torch.cumsum(count[order], dim=0) - count[order]
        number = torch.arange(len(splat)) - torch.repeat_interleave(first, count[order])
        x = low[splat, 0] + number % size[splat, 0]
        y = low[splat, 1] + number // size[splat, 0]
        tile = y * tiles_x + x
        by_tile = torch.argsort(tile, stable=True)
        return tile[by_tile], splat[by_tile]
