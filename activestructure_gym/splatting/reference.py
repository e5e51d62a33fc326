"""Rasterise in plain torch, with every pixel against every Gaussian.

The implementation is slow, works for any floating-point type, and is the reference for the tests. Formulas and numerics
follow [gsplat, code] 1.5.3: near plane 0.01 m, a blur added to the projected covariance (there 0.3 px^2), contributions
below 1/255 skipped. A pixel stops before the Gaussian that would reduce its transmittance to 1e-4 or below.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch

from activestructure_gym.geometry import PinholeCamera

NEAR_PLANE = 0.01  # metres
BLUR_VARIANCE = 0.02  # px^2, variance of the low-pass filter of EWA splatting
SLANT_VARIANCE = 0.03  # px^2, added to the covariance for depth slopes only
MIN_ALPHA = 1.0 / 255.0  # smaller alphas are skipped
MIN_TRANSMITTANCE = 1e-4  # a pixel stops before its transmittance falls to this
# Fraction of half the image: the projection's Jacobian follows the mean up to this margin outside the image.
CLAMP_MARGIN = 0.3
_PAIRS_AT_ONCE = 4_000_000  # pixel-Gaussian pairs computed at once, which limits the memory


def rasterize_reference(
    means: torch.Tensor,  # [N, 3] metres, world
    quaternions: torch.Tensor,  # [N, 4] wxyz, any length > 0
    log_scales: torch.Tensor,  # [N, 3] log of metres
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor,  # [N, 3] RGB, used unchanged
    camera_from_world: torch.Tensor,  # [4, 4]
    camera: PinholeCamera,
    *,
    max_alpha: float = 0.999,
    centre_depth: bool = False,
    blur_variance: float = BLUR_VARIANCE,  # px^2
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # colour [H, W, 3], accumulated depth [H, W], alpha [H, W]
    """Render colour, accumulated depth and alpha of one camera, with gradients by autograd."""
    color, depth, alpha, _ = blend_reference(
        means, quaternions, log_scales, opacity_logits, colors, camera_from_world, camera,
        max_alpha=max_alpha, centre_depth=centre_depth, blur_variance=blur_variance,
    )  # fmt: skip
    return color, depth, alpha


def blend_reference(
    means: torch.Tensor,  # [N, 3] metres, world
    quaternions: torch.Tensor,  # [N, 4] wxyz, any length > 0
    log_scales: torch.Tensor,  # [N, 3] log of metres
    opacity_logits: torch.Tensor,  # [N]
    features: torch.Tensor,  # [N, F] colours and further channels
    camera_from_world: torch.Tensor,  # [4, 4]
    camera: PinholeCamera,
    *,
    max_alpha: float = 0.999,
    centre_depth: bool = False,
    blur_variance: float = BLUR_VARIANCE,  # px^2
    min_depth: float = NEAR_PLANE,  # metres, lower limit of a Gaussian's depth at a pixel; gsplat has none (-inf)
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return features ``[H, W, F]``, accumulated depth, alpha and median depth (each ``[H, W]``) of one camera.

    The median depth is the depth of the Gaussian at which the transmittance first falls to 0.5 or below, and 0 if there
    is none. It has no gradient.
    """
    position, depth, axes = project(means, world_axes(quaternions, log_scales), camera_from_world, camera)
    inverse_covariance = _inverse_covariances(axes, blur_variance)
    slope = depth_slopes(axes)
    slope = torch.zeros_like(slope) if centre_depth else slope
    opacity = torch.sigmoid(opacity_logits)
    kept = torch.nonzero((depth.detach() >= NEAR_PLANE) & (opacity.detach() >= MIN_ALPHA))[:, 0]
    order = kept[torch.argsort(depth.detach()[kept], stable=True)]
    position, inverse_covariance, depth = position[order], inverse_covariance[order], depth[order]
    opacity, features, slope = opacity[order], features[order], slope[order]

    rows, columns = torch.meshgrid(
        torch.arange(camera.height, dtype=means.dtype, device=means.device) + 0.5,
        torch.arange(camera.width, dtype=means.dtype, device=means.device) + 0.5,
        indexing="ij",
    )
    pixels = torch.stack([columns.reshape(-1), rows.reshape(-1)], dim=1)  # [P, 2]
    at_once = max(1, _PAIRS_AT_ONCE // max(1, len(order)))
    outputs, alphas, medians = [], [], []
    for start in range(0, len(pixels), at_once):
        offset = pixels[start : start + at_once, None, :] - position[None]  # [p, M, 2]
        power = (
            -0.5 * (inverse_covariance[:, 0] * offset[..., 0] ** 2 + inverse_covariance[:, 2] * offset[..., 1] ** 2)
            - inverse_covariance[:, 1] * offset[..., 0] * offset[..., 1]
        )
        alpha = torch.clamp(opacity * torch.exp(power), max=max_alpha)
        alpha = torch.where(alpha.detach() < MIN_ALPHA, torch.zeros_like(alpha), alpha)
        after = torch.cumprod(1.0 - alpha, dim=1)
        before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
        # The transmittance only decreases, so a pixel stops exactly at the first Gaussian for which this test fails.
        counts = after.detach() > MIN_TRANSMITTANCE
        weight = alpha * before * counts
        here = (depth + (offset * slope).sum(dim=2)).clamp_min(min_depth)  # [p, M]
        outputs.append(torch.cat([weight @ features, (weight * here).sum(dim=1, keepdim=True)], dim=1))
        alphas.append(weight.sum(dim=1))
        # At most one Gaussian per pixel.
        halves = (counts & (after.detach() <= 0.5) & (before.detach() > 0.5)).to(depth.dtype)
        medians.append((halves * here.detach()).sum(dim=1))
    shape = (camera.height, camera.width)
    output = torch.cat(outputs).reshape(*shape, features.shape[1] + 1)
    alpha, median = torch.cat(alphas).reshape(shape), torch.cat(medians).reshape(shape)
    return output[..., :-1], output[..., -1], alpha, median


def camera_centre(camera_from_world: torch.Tensor) -> torch.Tensor:  # [4, 4] -> [3]
    """Return the camera centre in the world; ``camera_from_world`` is inverted as a general matrix, as in gsplat."""
    return -torch.linalg.solve(camera_from_world[:3, :3], camera_from_world[:3, 3])


def project_gaussians(
    means: torch.Tensor,  # [N, 3]
    quaternions: torch.Tensor,  # [N, 4]
    log_scales: torch.Tensor,  # [N, 3]
    camera_from_world: torch.Tensor,  # [4, 4]
    camera: PinholeCamera,
    blur_variance: float = BLUR_VARIANCE,  # px^2
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # [N, 2] px, [N, 3] inverse covariance xx, xy, yy, depth [N]
    """Project Gaussians by EWA splatting, with the Jacobian at the mean, clamped near the image border."""
    position, depth, axes = project(means, world_axes(quaternions, log_scales), camera_from_world, camera)
    return position, _inverse_covariances(axes, blur_variance), depth


def _inverse_covariances(axes: torch.Tensor, blur_variance: float) -> torch.Tensor:  # [N, 3, 3] -> [N, 3] xx, xy, yy
    covariance = axes[..., :2].transpose(1, 2) @ axes[..., :2]
    xx, xy, yy = covariance[:, 0, 0] + blur_variance, covariance[:, 0, 1], covariance[:, 1, 1] + blur_variance
    return torch.stack([yy, -xy, xx], dim=1) / (xx * yy - xy**2)[:, None]


def project(
    means: torch.Tensor,  # [..., N, 3] metres, world
    axes: torch.Tensor,  # [..., N, 3 axes, 3] metres, see `world_axes`
    camera_from_world: torch.Tensor,  # [..., 4, 4]
    camera: PinholeCamera,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # [..., N, 2] px, [..., N] metres, [..., N, 3 axes, 3]
    """Return the pixel positions and depths of means, and the axes of each Gaussian in pixels (x, y) and metres (z).

    The position of a mean in front of the near plane is finite.
    """
    focal, centre, lowest, highest = lens(camera, means.dtype, means.device)
    turn = camera_from_world[..., :3, :3].transpose(-1, -2)
    beside, z = (means @ turn + camera_from_world[..., None, :3, 3]).split([2, 1], dim=-1)
    # Points in front of the near plane are removed later. A finite depth keeps their gradient finite (and zero).
    inverse_depth = 1.0 / torch.where(z.detach() >= NEAR_PLANE, z, 1.0)
    slope = beside * inverse_depth
    turned, along = (axes @ turn[..., None, :, :]).split([2, 1], dim=-1)
    clamped = slope.clamp(lowest, highest)[..., None, :]
    across = (focal * inverse_depth)[..., None, :] * (turned - clamped * along)
    return slope * focal + centre, z[..., 0], torch.cat([across, along], dim=-1)


@lru_cache(64)
def lens(camera: PinholeCamera, dtype: torch.dtype, device: torch.device) -> tuple[torch.Tensor, ...]:
    """Return focal length and principal point in pixels, lowest and highest slope x / z, y / z ([2] each).

    They are kept, since a transfer to a device takes longer than projecting.
    """
    size, focal = np.array([camera.width, camera.height]), np.array([camera.fx, camera.fy])
    centre, margin = np.array([camera.cx, camera.cy]), CLAMP_MARGIN * 0.5 * size / focal
    rows = np.stack([focal, centre, -centre / focal - margin, (size - centre) / focal + margin])
    return torch.tensor(rows, dtype=dtype, device=device).unbind()


def depth_slopes(axes: torch.Tensor) -> torch.Tensor:  # [..., N, 3 axes, 3] -> [..., N, 2] metres per pixel
    """Return the slope of each Gaussian's depth in the image at its mean, from the axes of `project`.

    The depth is that at which a ray meets the Gaussian: at its highest density along the ray ([yu2024]). To first order
    of the projection, it is a linear function of the pixel. Its slope is the covariance of pixel and depth divided by
    the covariance of the pixel ([zhang2024]). For a flat Gaussian this is the slope of its plane.
    """
    x, y, z = axes.unbind(-1)  # [..., N, axis]
    # Cross products avoid cancellation for needle-shaped Gaussians: |x cross y|^2 = xx yy - xy^2, and so on.
    area = torch.linalg.cross(x, y, dim=-1)
    sides = torch.linalg.cross(torch.stack([z, x], dim=-2), torch.stack([y, z], dim=-2), dim=-1)
    pixels = torch.stack([x, y], dim=-2)
    numerators = torch.addcmul(sides * area[..., None, :], z[..., None, :], pixels, value=SLANT_VARIANCE).sum(dim=-1)
    squares = (area * area).sum(dim=-1, keepdim=True) + SLANT_VARIANCE * (pixels * pixels).sum(dim=(-1, -2))[..., None]
    return numerators / (squares + SLANT_VARIANCE**2)


def world_axes(
    quaternions: torch.Tensor,  # [N, 4] wxyz, any length > 0
    log_scales: torch.Tensor,  # [N, 3]
) -> torch.Tensor:  # [N, 3 axes, 3] metres, world
    """Return the axes of each Gaussian as rows, one standard deviation long."""
    return rotation_matrices(quaternions).transpose(1, 2) * torch.exp(log_scales)[..., None]


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:  # [N, 4] wxyz -> [N, 3, 3]
    """Return the rotation matrices of quaternions of any length above 0.

    Each entry is a sum of products of two components, so one matrix product gives all of them.
    """
    unit = quaternions / quaternions.norm(dim=1, keepdim=True)
    products = (unit[:, :, None] * unit[:, None, :]).reshape(-1, 16)
    return (products @ _rotation_terms(unit.dtype, unit.device)).reshape(-1, 3, 3)


@lru_cache
def _rotation_terms(dtype: torch.dtype, device: torch.device) -> torch.Tensor:  # [16, 9]
    """Return the factor of each product of two components (ww, wx, ...) in each entry of a rotation matrix."""
    terms = np.zeros((4, 4, 3, 3))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        terms[0, 0, i, i] = terms[i + 1, i + 1, i, i] = 1.0
        terms[j + 1, j + 1, i, i] = terms[k + 1, k + 1, i, i] = -1.0
        terms[i + 1, j + 1, i, j] = terms[i + 1, j + 1, j, i] = 2.0
        terms[0, k + 1, i, j], terms[0, k + 1, j, i] = -2.0, 2.0
    return torch.tensor(terms.reshape(16, 9), dtype=dtype, device=device)
