"""Rasterise in plain torch, with every pixel against every Gaussian.

The implementation is slow, works for any floating-point type, and is the reference for the tests. Formulas and numerics
follow [gsplat, code] 1.5.3: near plane 0.01 m, a blur added to the projected covariance (there 0.3 px^2), contributions
below 1/255 skipped. A pixel stops before the Gaussian that would reduce its transmittance to 1e-4 or below.
"""

from __future__ import annotations

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
    position, inverse_covariance, depth = project_gaussians(
        means, quaternions, log_scales, camera_from_world, camera, blur_variance
    )
    slope = depth_slopes(means, quaternions, log_scales, camera_from_world, camera)
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
    position, depth = project_means(means, camera_from_world, camera)
    factor = _projected_axes(means, quaternions, log_scales, camera_from_world, camera)
    covariance = factor[:, :2] @ factor[:, :2].transpose(1, 2)
    xx, xy, yy = covariance[:, 0, 0] + blur_variance, covariance[:, 0, 1], covariance[:, 1, 1] + blur_variance
    determinant = xx * yy - xy**2
    inverse = torch.stack([yy, -xy, xx], dim=1) / determinant[:, None]
    return position, inverse, depth


def project_means(
    means: torch.Tensor,  # [N, 3]
    camera_from_world: torch.Tensor,  # [4, 4] or [C, 4, 4]
    camera: PinholeCamera,
) -> tuple[torch.Tensor, torch.Tensor]:  # [..., N, 2] px, [..., N] metres
    """Return the pixel positions and depths of means. The position of a mean in front of the near plane is finite."""
    points, inverse_depth = _camera_points(means, camera_from_world)
    focal, centre = points.new_tensor([camera.fx, camera.fy]), points.new_tensor([camera.cx, camera.cy])
    return points[..., :2] * inverse_depth[..., None] * focal + centre, points[..., 2]


def depth_slopes(
    means: torch.Tensor,  # [N, 3]
    quaternions: torch.Tensor,  # [N, 4]
    log_scales: torch.Tensor,  # [N, 3]
    camera_from_world: torch.Tensor,  # [4, 4] or [C, 4, 4]
    camera: PinholeCamera,
) -> torch.Tensor:  # [..., N, 2] metres per pixel
    """Return the slope of each Gaussian's depth in the image at its mean, in metres per pixel.

    The depth is that at which a ray meets the Gaussian: at its highest density along the ray ([yu2024]). To first order
    of the projection, it is a linear function of the pixel. Its slope is the covariance of pixel and depth divided by
    the covariance of the pixel ([zhang2024]). For a flat Gaussian this is the slope of its plane.
    """
    factor = _projected_axes(means, quaternions, log_scales, camera_from_world, camera)
    x, y, z = torch.unbind(factor, dim=-2)  # [..., N, axis]
    # Cross products avoid cancellation for needle-shaped Gaussians: |x cross y|^2 = xx yy - xy^2, and so on.
    area = torch.linalg.cross(x, y, dim=-1)
    numerators = [
        (torch.linalg.cross(z, y, dim=-1) * area + SLANT_VARIANCE * z * x).sum(dim=-1),
        (torch.linalg.cross(x, z, dim=-1) * area + SLANT_VARIANCE * z * y).sum(dim=-1),
    ]
    determinant = (area * area + SLANT_VARIANCE * (x * x + y * y)).sum(dim=-1) + SLANT_VARIANCE**2
    return torch.stack(numerators, dim=-1) / determinant[..., None]


def _camera_points(
    means: torch.Tensor, camera_from_world: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:  # [..., N, 3] metres, [..., N] 1 / depth
    points = means @ camera_from_world[..., :3, :3].transpose(-1, -2) + camera_from_world[..., None, :3, 3]
    z = points[..., 2]
    # Points in front of the near plane are removed later. A finite depth keeps their gradient finite (and zero).
    return points, 1.0 / torch.where(z.detach() >= NEAR_PLANE, z, torch.ones_like(z))


def _projected_axes(
    means: torch.Tensor,
    quaternions: torch.Tensor,
    log_scales: torch.Tensor,
    camera_from_world: torch.Tensor,
    camera: PinholeCamera,
) -> torch.Tensor:  # [..., N, 3, 3]
    """Return the axes of each Gaussian as columns, one standard deviation long, in pixels (x, y) and metres (z)."""
    points, inverse_depth = _camera_points(means, camera_from_world)
    slope_x, slope_y = points[..., 0] * inverse_depth, points[..., 1] * inverse_depth
    margin_x = CLAMP_MARGIN * 0.5 * camera.width / camera.fx
    margin_y = CLAMP_MARGIN * 0.5 * camera.height / camera.fy
    clamped_x = slope_x.clamp(-camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    clamped_y = slope_y.clamp(-camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    fx, fy = camera.fx * inverse_depth, camera.fy * inverse_depth
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    rows = [fx, zero, -fx * clamped_x, zero, fy, -fy * clamped_y, zero, zero, one]
    jacobian = torch.stack(rows, dim=-1).reshape(*fx.shape, 3, 3)
    turned = camera_from_world[..., None, :3, :3] @ rotation_matrices(quaternions)
    return jacobian @ turned * torch.exp(log_scales)[:, None, :]


def rotation_matrices(quaternions: torch.Tensor) -> torch.Tensor:  # [N, 4] wxyz -> [N, 3, 3]
    """Return the rotation matrices of quaternions of any length above 0."""
    w, x, y, z = torch.unbind(quaternions / quaternions.norm(dim=1, keepdim=True), dim=1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).reshape(-1, 3, 3)
