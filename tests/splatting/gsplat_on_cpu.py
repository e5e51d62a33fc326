"""Stand-ins for the compiled functions of gsplat 1.5, so that gsplat's own Python code runs on a CPU.

Everything in Python stays gsplat's: checks of shapes, padding of channels, autograd functions. What its extension
computes is computed here in float32 after the rules of its `.cu` files: the box that knows the opacity, the order by
image, tile and bits of the depth, alpha at most 0.999 and skipped below 1/255, a pixel that stops before a
transmittance of 1e-4, a backward pass from back to front that begins with 1 - alpha. Elements that a kernel leaves
unwritten are NaN.
"""

import contextlib
import math
from collections import Counter
from typing import Any, NamedTuple

import numpy as np
import torch

MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE = np.float32(0.999), np.float32(1.0 / 255.0), np.float32(1e-4)
ONE = np.float32(1.0)
# The numbers of channels for which the extension has kernels.
CHANNELS = (1, 2, 3, 4, 5, 8, 9, 16, 17, 32, 33, 64, 65, 128, 129, 256, 257, 512, 513)

CALLS: Counter[str] = Counter()  # calls of each compiled function
RUNNING: list[str] = []  # the function that is running


# Projection: gsplat's torch formulas with its float32 determinant.


def _projected(means, quats, scales, viewmats, Ks, width, height, eps2d):
    from gsplat.cuda._torch_impl import _persp_proj, _quat_scale_to_covar_preci, _world_to_cam

    covariances, _ = _quat_scale_to_covar_preci(quats, scales, True, False)
    points, turned = _world_to_cam(means, covariances, viewmats)
    z = points[..., 2]
    # Points before the near plane are not drawn; a depth of 1 keeps their numbers finite.
    safe = torch.cat([points[..., :2], torch.where(z < 0.01, torch.ones_like(z), z)[..., None]], dim=-1)
    means2d, covariance = _persp_proj(safe, turned, Ks, width, height)
    xx, xy, yy = covariance[..., 0, 0] + eps2d, covariance[..., 0, 1], covariance[..., 1, 1] + eps2d
    determinant = xx * yy - xy * covariance[..., 1, 0]
    conics = torch.stack([yy, -xy, xx], dim=-1) / determinant[..., None]
    return means2d, conics, z, (xx, yy, determinant)


def _visible(means, quats, scales, opacities, viewmats, Ks, width, height, eps2d, near, far, radius_clip):
    """Radii (0 where not drawn), means, depths and conics, each [C, N, ...]."""
    means2d, conics, z, (xx, yy, determinant) = _projected(means, quats, scales, viewmats, Ks, width, height, eps2d)
    opacity = opacities.expand_as(z)
    extent = (2.0 * torch.log(opacity / float(MIN_ALPHA))).sqrt().clamp(max=3.33)
    radius = torch.ceil(extent[..., None] * torch.stack([xx, yy], dim=-1).sqrt())
    size = torch.tensor([width, height])
    drawn = (z >= near) & (z <= far) & (determinant > 0) & (opacity >= MIN_ALPHA) & ~(radius <= radius_clip).all(dim=-1)
    drawn &= ((means2d + radius > 0) & (means2d - radius < size)).all(dim=-1)
    return torch.where(drawn[..., None], radius, 0.0).int(), means2d, z, conics


def projection_ewa_3dgs_fused_fwd(
    means,
    covars,
    quats,
    scales,
    opacities,
    viewmats,
    Ks,
    width,
    height,
    eps2d,
    near,
    far,
    radius_clip,
    compensate,
    model,
):
    assert covars is None and not compensate and model == "CameraModelType.PINHOLE"
    radii, means2d, depths, conics = _visible(
        means, quats, scales, opacities, viewmats, Ks, width, height, eps2d, near, far, radius_clip
    )
    hidden = (radii == 0).all(dim=-1)
    means2d, conics = (array.masked_fill(hidden[..., None], math.nan) for array in (means2d, conics))
    return radii, means2d, depths.masked_fill(hidden, math.nan), conics, None


def projection_ewa_3dgs_packed_fwd(
    means,
    covars,
    quats,
    scales,
    opacities,
    viewmats,
    Ks,
    width,
    height,
    eps2d,
    near,
    far,
    radius_clip,
    compensate,
    model,
):
    assert covars is None and not compensate and model == "CameraModelType.PINHOLE"
    found = _visible(means, quats, scales, opacities, viewmats, Ks, width, height, eps2d, near, far, radius_clip)
    drawn = (found[0] > 0).all(dim=-1)
    cameras, gaussians = torch.nonzero(drawn, as_tuple=True)
    first = torch.cat([torch.zeros(1, dtype=torch.int64), drawn.sum(dim=1).cumsum(0)]).int()
    return first, torch.zeros_like(cameras), cameras, gaussians, *(array[drawn] for array in found), None


def projection_ewa_3dgs_fused_bwd(
    means, covars, quats, scales, viewmats, Ks, width, height, eps2d, model, radii, conics, compensations,
    v_means2d, v_depths, v_conics, v_compensations, of_views,
):  # fmt: skip
    drawn = (radii > 0).all(dim=-1)
    with torch.enable_grad():
        leaves = [array.detach().requires_grad_() for array in (means, quats, scales, viewmats)]
        inputs: list[Any] = [*leaves, Ks, width, height, eps2d]
        means2d, shapes, z, _ = _projected(*inputs)
        pairs = ((means2d, v_means2d), (shapes, v_conics), (z, v_depths))
        total = sum((value[drawn] * gradient[drawn]).sum() for value, gradient in pairs)
        v_means, v_quats, v_scales, v_views = torch.autograd.grad(total, leaves)
    return v_means, None, v_quats, v_scales, v_views if of_views else None


# Lists of the tiles


def intersect_tile(means2d, radii, depths, image_ids, gaussian_ids, images, tile, tiles_x, tiles_y, sort, segmented):
    assert sort and not segmented
    tile_bits = int(math.log2(tiles_x * tiles_y)) + 1
    assert int(math.log2(images)) + 1 + tile_bits <= 32
    places, radii = means2d.reshape(-1, 2).numpy(), radii.reshape(-1, 2).numpy()
    if image_ids is None:
        image_ids = torch.arange(images).repeat_interleave(means2d.shape[-2])
    middle, reach = places / np.float32(tile), radii / np.float32(tile)
    most = np.array([tiles_x, tiles_y])
    with np.errstate(invalid="ignore"):
        low = np.clip(np.nan_to_num(np.floor(middle - reach)), 0, most).astype(int)
        high = np.clip(np.nan_to_num(np.ceil(middle + reach)), 0, most).astype(int)
    across, down = np.where((radii > 0).all(axis=1), (high - low).T, 0)
    counts = across * down
    flat = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(flat)) - np.repeat(np.cumsum(counts) - counts, counts)
    x, y = low[flat, 0] + within % across[flat], low[flat, 1] + within // across[flat]
    bits = depths.reshape(-1).numpy().view(np.uint32).astype(np.int64)
    keys = (image_ids.numpy()[flat] << (32 + tile_bits)) | ((y * tiles_x + x) << 32) | bits[flat]
    order = np.argsort(keys, kind="stable")
    counts = torch.from_numpy(counts.astype(np.int32)).reshape(depths.shape)
    return counts, torch.from_numpy(keys[order]), torch.from_numpy(flat[order].astype(np.int32))


def intersect_offset(keys, images, tiles_x, tiles_y):
    tile_bits, high = int(math.log2(tiles_x * tiles_y)) + 1, keys.numpy() >> 32
    tiles = (high >> tile_bits) * (tiles_x * tiles_y) + (high & ((1 << tile_bits) - 1))
    first = np.searchsorted(tiles, np.arange(images * tiles_x * tiles_y)).astype(np.int32)
    return torch.from_numpy(first).reshape(images, tiles_y, tiles_x)


# Blending, tile by tile


class _Tile(NamedTuple):
    """A tile's entries M, front to back, at its pixels P."""

    image: int
    rows: slice
    columns: slice
    entries: slice
    ids: np.ndarray  # [M]
    dx: np.ndarray  # [P, M] px, from the pixel to the mean
    dy: np.ndarray
    falloff: np.ndarray  # [P, M] exp(-sigma)
    alpha: np.ndarray  # [P, M], 0 where skipped


def _tiles(means2d, conics, opacities, width, height, tile, offsets, flat):
    edges = np.append(offsets.reshape(-1).numpy(), len(flat))
    means2d, conics, opacities = (
        means2d.reshape(-1, 2).numpy(),
        conics.reshape(-1, 3).numpy(),
        opacities.reshape(-1).numpy(),
    )
    down, across = offsets.shape[-2:]
    for number, (first, stop) in enumerate(zip(edges[:-1], edges[1:])):
        if first == stop:
            continue
        image, y, x = number // (down * across), number // across % down, number % across
        rows, columns = slice(y * tile, min((y + 1) * tile, height)), slice(x * tile, min((x + 1) * tile, width))
        ids = flat[first:stop].numpy()
        v, u = (part.reshape(-1, 1).astype(np.float32) + np.float32(0.5) for part in np.mgrid[rows, columns])
        dx, dy = means2d[ids, 0] - u, means2d[ids, 1] - v
        a, b, c = conics[ids].T
        sigma = np.float32(0.5) * (a * dx * dx + c * dy * dy) + b * dx * dy
        with np.errstate(over="ignore"):  # of a negative sigma, which is skipped
            falloff = np.exp(-sigma)
            alpha = np.minimum(MAX_ALPHA, opacities[ids] * falloff)
        alpha = np.where((sigma < 0) | (alpha < MIN_ALPHA), np.float32(0.0), alpha)
        yield _Tile(image, rows, columns, slice(first, stop), ids, dx, dy, falloff, alpha)


def rasterize_to_pixels_3dgs_fwd(
    means2d, conics, colors, opacities, backgrounds, masks, width, height, tile, offsets, flat
):
    assert backgrounds is None and masks is None and colors.shape[-1] in CHANNELS
    shape = (*offsets.shape[:-2], height, width)
    out = np.zeros((offsets.shape[:-2].numel(), height, width, colors.shape[-1]), np.float32)
    alphas, last = np.zeros(out.shape[:3], np.float32), np.zeros(out.shape[:3], np.int32)
    values = colors.reshape(-1, colors.shape[-1]).numpy()
    for one in _tiles(means2d, conics, opacities, width, height, tile, offsets, flat):
        after = np.cumprod(ONE - one.alpha, axis=1)
        blended = np.where(after > MIN_TRANSMITTANCE, one.alpha, np.float32(0.0))
        after = np.cumprod(ONE - blended, axis=1)
        before = np.concatenate([np.ones_like(after[:, :1]), after[:, :-1]], axis=1)
        at = (one.image, one.rows, one.columns)
        out[at] = (blended * before @ values[one.ids]).reshape(out[at].shape)
        alphas[at] = (ONE - after[:, -1]).reshape(alphas[at].shape)
        numbers = np.where(blended > 0, np.arange(one.entries.start, one.entries.stop), 0)
        last[at] = numbers.max(axis=1).reshape(last[at].shape)
    return (
        torch.from_numpy(out).reshape(*shape, -1), torch.from_numpy(alphas).reshape(*shape, 1),
        torch.from_numpy(last).reshape(shape),
    )  # fmt: skip


def rasterize_to_pixels_3dgs_bwd(
    means2d, conics, colors, opacities, backgrounds, masks, width, height, tile, offsets, flat, alphas, last,
    v_colors_out, v_alphas_out, absgrad,
):  # fmt: skip
    assert not absgrad
    gradients = [torch.zeros_like(array) for array in (means2d, conics, colors, opacities)]
    channels = colors.shape[-1]
    v_means, v_conics, v_colors = (array.reshape(-1, array.shape[-1]).numpy() for array in gradients[:3])
    v_opacities, opacity_of = gradients[3].reshape(-1).numpy(), opacities.reshape(-1).numpy()
    values, shapes = colors.reshape(-1, channels).numpy(), conics.reshape(-1, 3).numpy()
    images = [array.numpy().reshape(-1, height, width) for array in (alphas, last, v_alphas_out)]
    v_out = v_colors_out.numpy().reshape(-1, height, width, channels)
    for one in _tiles(means2d, conics, opacities, width, height, tile, offsets, flat):
        at = (one.image, one.rows, one.columns)
        shown, ends, by_alpha = (array[at].reshape(-1, 1) for array in images)
        by_color = v_out[at].reshape(-1, channels)
        alpha = np.where(np.arange(one.entries.start, one.entries.stop) <= ends, one.alpha, np.float32(0.0))
        end, back = ONE - shown, ONE / (ONE - alpha)  # `end`: the transmittance behind the last entry
        left = end * np.cumprod(back[:, ::-1], axis=1)[:, ::-1]  # before each entry
        weight = alpha * left
        np.add.at(v_colors, one.ids, weight.T @ by_color)
        wanted = by_color @ values[one.ids].T
        behind = np.cumsum((weight * wanted)[:, ::-1], axis=1)[:, ::-1] - weight * wanted
        by_entry = wanted * left - behind * back + end * back * by_alpha
        opaque = opacity_of[one.ids] * one.falloff
        by_entry = np.where((alpha > 0) & (opaque <= MAX_ALPHA), by_entry, np.float32(0.0))
        by_sigma = np.where(by_entry == 0, np.float32(0.0), -opaque * by_entry)
        dx, dy, (a, b, c) = one.dx, one.dy, shapes[one.ids].T
        half = np.float32(0.5)
        sums = (half * by_sigma * dx * dx, by_sigma * dx * dy, half * by_sigma * dy * dy)
        np.add.at(v_conics, one.ids, np.stack([part.sum(axis=0) for part in sums], axis=1))
        moves = (by_sigma * (a * dx + b * dy), by_sigma * (b * dx + c * dy))
        np.add.at(v_means, one.ids, np.stack([part.sum(axis=0) for part in moves], axis=1))
        np.add.at(v_opacities, one.ids, np.where(by_entry == 0, np.float32(0.0), one.falloff * by_entry).sum(axis=0))
    return None, *gradients


# The optimiser


def adam(parameters, gradient, first, second, valid, rate, beta1, beta2, epsilon):
    assert valid.dtype == torch.bool and valid.shape == parameters.shape[:1]
    first[valid] = beta1 * first[valid] + (1.0 - beta1) * gradient[valid]
    second[valid] = beta2 * second[valid] + (1.0 - beta2) * gradient[valid] ** 2
    parameters[valid] -= rate * first[valid] / (second[valid].sqrt() + epsilon)


_FUNCTIONS = {
    function.__name__: function
    for function in (
        projection_ewa_3dgs_fused_fwd,
        projection_ewa_3dgs_packed_fwd,
        projection_ewa_3dgs_fused_bwd,
        intersect_tile,
        intersect_offset,
        rasterize_to_pixels_3dgs_fwd,
        rasterize_to_pixels_3dgs_bwd,
        adam,
    )  # fmt: skip
}


def _compiled(name):
    def call(*arguments):
        CALLS[name] += 1
        for number, argument in enumerate(arguments):
            if isinstance(argument, torch.Tensor):
                assert argument.is_contiguous(), f"argument {number} of {name} must be contiguous"
                assert argument.dtype != torch.float64, f"argument {number} of {name} is float64"
        RUNNING.append(name)
        try:
            with torch.no_grad():
                return _FUNCTIONS[name](*arguments)
        finally:
            RUNNING.pop()

    return call


@contextlib.contextmanager
def on_cpu():
    """Replace the compiled functions, and let the backend `gsplat` run on the CPU."""
    from gsplat.cuda import _wrapper

    from activestructure_gym.splatting import gsplat_backend
    from activestructure_gym.splatting.rasterizers import rasterizer

    places = {
        (_wrapper, "_make_lazy_cuda_func"): _compiled, (_wrapper, "_make_lazy_cuda_obj"): str,
        (gsplat_backend, "DEVICE"): "cpu",
    }  # fmt: skip
    before = {place: getattr(*place) for place in places}
    caches = (gsplat_backend.gsplat_status, rasterizer)
    try:
        for place, value in places.items():
            setattr(*place, value)
        for cache in caches:
            cache.cache_clear()
        yield
    finally:
        for place, value in before.items():
            setattr(*place, value)
        for cache in caches:
            cache.cache_clear()
