"""Provide `rasterize`, one differentiable function with three implementations: CPU kernels, gsplat, plain torch."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import gsplat_backend
from activestructure_gym.splatting.autograd import CpuOptions, CpuRasterization
from activestructure_gym.splatting.packing import parameter_rows
from activestructure_gym.splatting.reference import BLUR_VARIANCE, blend_reference, camera_centre
from activestructure_gym.splatting.spherical_harmonics import TERMS, evaluate_sh

__all__ = ["Rasterization", "camera_twist_gradient", "parameter_rows", "rasterize"]


@dataclass(frozen=True)
class Rasterization:
    """Hold the rendered images of one camera, or of C cameras with a leading axis C."""

    color: torch.Tensor  # [..., H, W, 3] RGB
    depth: torch.Tensor  # [..., H, W] accumulated depth: sum of weight times depth, metres
    alpha: torch.Tensor  # [..., H, W] 0..1
    channels: torch.Tensor | None = None  # [..., H, W, D] sum of weight times channel; None without channels
    median_depth: torch.Tensor | None = None  # [..., H, W] metres, see `rasterize`; None if not requested

    @property
    def expected_depth(self) -> torch.Tensor:  # [..., H, W]
        """Return accumulated depth divided by alpha, in metres; 0 where nothing is rendered."""
        return self.depth / self.alpha.clamp_min(1e-10)


@dataclass(frozen=True)
class _Request:
    """Hold the arguments of `rasterize`; exactly one of ``colors`` and ``sh`` is given."""

    means: torch.Tensor
    quaternions: torch.Tensor
    log_scales: torch.Tensor
    opacity_logits: torch.Tensor
    colors: torch.Tensor | None
    sh: torch.Tensor | None
    channels: torch.Tensor | None
    camera_from_world: torch.Tensor
    camera: PinholeCamera
    max_alpha: float
    centre_depth: bool
    blur_variance: float
    median_depth: bool
    threads: int | None


def rasterize(
    means: torch.Tensor,  # [N, 3] metres, world
    quaternions: torch.Tensor,  # [N, 4] wxyz, any length > 0
    log_scales: torch.Tensor,  # [N, 3] log of metres
    opacity_logits: torch.Tensor,  # [N]
    colors: torch.Tensor | None = None,  # [N, 3] used unchanged
    *,
    camera_from_world: torch.Tensor,  # [4, 4] or [C, 4, 4]
    camera: PinholeCamera,
    # [N, K, 3] spherical harmonics of degree 0 to 3 instead of colours, K = 1, 4, 9 or 16
    sh: torch.Tensor | None = None,
    channels: torch.Tensor | None = None,  # [N, D] further values to blend
    centre_depth: bool = False,
    blur_variance: float = BLUR_VARIANCE,
    median_depth: bool = False,
    backend: str = "auto",
    max_alpha: float = 0.999,
    threads: int | None = None,
) -> Rasterization:
    """Render Gaussians, with gradients to every given tensor.

    The gradient of ``camera_from_world`` treats its rows 0 to 2 as twelve independent numbers; see
    `camera_twist_gradient`.

    Parameters
    ----------
    means
        [N, 3] metres, world.
    quaternions
        [N, 4] wxyz, of any length above 0.
    log_scales
        [N, 3] natural logarithms of the standard deviations in metres.
    opacity_logits
        [N] logits of the opacities at the centres.
    colors
        [N, 3] RGB, used unchanged; either these or ``sh``.
    camera_from_world
        [4, 4], or [C, 4, 4] for several cameras at once: the same as one call each.
    camera
        Image size and intrinsics.
    sh
        [N, K, 3] coefficients of spherical harmonics of degree 0 to 3, K = 1, 4, 9 or 16, as in 3D Gaussian splatting.
        Colour = max(0, 0.5 + sum of coefficient times harmonic), for the direction from the camera centre.
    channels
        [N, D] further values to blend.
    centre_depth
        Whether to use the depth of each Gaussian's centre, as 3D Gaussian splatting does. Otherwise a pixel uses the
        depth where its ray meets the Gaussian (see Notes); for an oblique disk this is on the disk.
    blur_variance
        px^2 added to a Gaussian's covariance in the image. 3D Gaussian splatting and gsplat use 0.3, which blurs small
        images noticeably.
    median_depth
        Whether to also return the depth of the Gaussian at which the transmittance, front to back, first falls to 0.5
        or below. It is 0 where alpha remains below 0.5, and has no gradient.
    backend
        ``"cpu"`` (compiled kernels), ``"gsplat"``, ``"reference"`` (plain torch), or ``"auto"``: gsplat for CUDA
        tensors, the kernels for float32 on the CPU, the reference otherwise.
    max_alpha
        Upper limit of a Gaussian's opacity in a pixel.
    threads
        Threads of the backend ``"cpu"``. Default: the cores of this process, fewer with ``OMP_NUM_THREADS`` or on an
        overloaded machine. Results are the same for any number.

    Returns
    -------
    Rasterization
        Colour, accumulated depth in metres, alpha, and the further requested images; with a leading axis [C] for
        several cameras.

    Raises
    ------
    InputError
        For tensors that do not fit together, an unknown backend, or one that cannot run this request here.

    Notes
    -----
    Source: Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering", SIGGRAPH 2023, eqs. 3, 5 and
    6; cut-offs are those of [gsplat, code] 1.5.3. A ray meets a Gaussian at its highest density along the ray, to first
    order in the pixel, as in Zhang et al., "RaDe-GS: Rasterizing Depth in Gaussian Splatting", 2024.

    Examples
    --------
    >>> one = torch.tensor([[0.0, 0.0, 2.0]])
    >>> picture = rasterize(
    ...     one, torch.tensor([[1.0, 0.0, 0.0, 0.0]]), torch.full((1, 3), -2.0), torch.tensor([2.0]), torch.ones(1, 3),
    ...     camera_from_world=torch.eye(4), camera=PinholeCamera.from_size(32, 24),
    ... )
    >>> picture.color.shape, bool(picture.alpha[12, 16] > 0.5)
    (torch.Size([24, 32, 3]), True)
    """
    if backend != "auto" and backend not in _RENDERERS:
        raise unknown_name("splatting backend", backend, _RENDERERS)
    request = _Request(
        means, quaternions, log_scales, opacity_logits, colors, sh, channels, camera_from_world, camera, max_alpha,
        centre_depth, blur_variance, median_depth, threads,
    )  # fmt: skip
    _check(request)
    if backend == "auto":
        backend = "gsplat" if means.is_cuda else "cpu" if means.dtype == torch.float32 else "reference"
    return _RENDERERS[backend](request)


def camera_twist_gradient(
    camera_from_world: torch.Tensor,  # [..., 4, 4]
    gradient: torch.Tensor,  # [..., 4, 4] gradient by its entries, as given by `rasterize`
) -> torch.Tensor:  # [..., 6]
    """Return the gradient with respect to a twist (rho in metres, phi in radians) at 0.

    The twist changes camera_from_world to Exp(rho, phi) camera_from_world (`activestructure_gym.geometry.se3_exp`).
    Source: [sola2018].
    """
    pose, gradient = camera_from_world.detach()[..., :3, :], gradient[..., :3, :]
    turn = torch.linalg.cross(pose, gradient, dim=-2).sum(dim=-1)  # column by column
    return torch.cat([gradient[..., 3], turn], dim=-1)


def _check(request: _Request) -> None:
    """Raise `InputError` if types, shapes or values of the arguments of `rasterize` do not fit together."""
    count = len(request.means) if isinstance(request.means, torch.Tensor) and request.means.dim() else 0
    shapes = {
        "means": (count, 3), "quaternions": (count, 4), "log_scales": (count, 3), "opacity_logits": (count,),
    }  # fmt: skip
    if (request.colors is None) == (request.sh is None):
        came = "neither" if request.sh is None else "both"
        raise InputError(f"rasterize takes either colors [N, 3] or sh [N, K, 3], got {came}; give exactly one of them.")
    if request.colors is not None:
        shapes["colors"] = (count, 3)
    for name in (*shapes, "sh", "channels", "camera_from_world"):
        value = getattr(request, name)
        if value is None and name in ("sh", "channels"):
            continue
        if not isinstance(value, torch.Tensor):
            raise InputError(
                f"{name} must be a torch tensor, got {type(value).__name__}; use torch.from_numpy for arrays."
            )
        if name in shapes and tuple(value.shape) != shapes[name]:
            of = "" if name == "means" else f" for means of {tuple(request.means.shape)}"
            wanted = "[N, 3]" if name == "means" else str(shapes[name])
            raise InputError(f"{name} must have the shape {wanted}{of}, got {tuple(value.shape)}.")
        if value.dtype != request.means.dtype or value.device != request.means.device:
            raise InputError(
                f"all tensors must be of one type on one device: means are {request.means.dtype} on "
                f"{request.means.device}, {name} {value.dtype} on {value.device}; convert {name} with .to(means)."
            )
    if not request.means.is_floating_point():
        raise InputError(f"means must be of a floating point type, got {request.means.dtype}; use means.float().")
    sh, channels, pose = request.sh, request.channels, request.camera_from_world
    if sh is not None and (sh.dim() != 3 or len(sh) != count or sh.shape[1] not in TERMS or sh.shape[2] != 3):
        raise InputError(f"sh must have the shape [{count}, K, 3], where K is 1, 4, 9 or 16, got {tuple(sh.shape)}.")
    if channels is not None and (channels.dim() != 2 or len(channels) != count or channels.shape[1] < 1):
        raise InputError(
            f"channels must have the shape [{count}, D] with D at least 1, got {tuple(channels.shape)}; "
            "leave them out if there are none."
        )
    if pose.dim() not in (2, 3) or tuple(pose.shape[-2:]) != (4, 4) or not len(pose):
        raise InputError(
            f"camera_from_world must have the shape [4, 4], or [C, 4, 4] with C at least 1, got {tuple(pose.shape)}."
        )
    if not isinstance(request.camera, PinholeCamera):
        raise InputError(f"camera must be a PinholeCamera, got {type(request.camera).__name__}.")
    if not 0.0 < request.max_alpha < 1.0:
        raise InputError(f"max_alpha must lie in (0, 1), got {request.max_alpha}.")
    if not 0.0 < request.blur_variance <= 100.0:
        raise InputError(f"blur_variance must lie in (0, 100] px^2, got {request.blur_variance}.")
    if request.threads is not None and request.threads < 1:
        raise InputError(f"threads must be at least 1, got {request.threads}; leave it out for a good default.")


def _render_reference(request: _Request) -> Rasterization:
    if request.camera_from_world.dim() == 2:
        return _reference_of_one(request, request.camera_from_world)
    each = [_reference_of_one(request, pose) for pose in request.camera_from_world]
    channels = [one.channels for one in each if one.channels is not None]
    medians = [one.median_depth for one in each if one.median_depth is not None]
    return Rasterization(
        torch.stack([one.color for one in each]),
        torch.stack([one.depth for one in each]),
        torch.stack([one.alpha for one in each]),
        torch.stack(channels) if channels else None,
        torch.stack(medians) if medians else None,
    )


def _reference_of_one(request: _Request, pose: torch.Tensor) -> Rasterization:
    colors, channels = request.colors, request.channels
    if colors is None:
        assert request.sh is not None
        colors = evaluate_sh(request.sh, request.means - camera_centre(pose))
    features = colors if channels is None else torch.cat([colors, channels], dim=1)
    picture, depth, alpha, median = blend_reference(
        request.means, request.quaternions, request.log_scales, request.opacity_logits, features, pose, request.camera,
        max_alpha=request.max_alpha, centre_depth=request.centre_depth, blur_variance=request.blur_variance,
    )  # fmt: skip
    extra = None if channels is None else picture[..., 3:]
    return Rasterization(picture[..., :3], depth, alpha, extra, median if request.median_depth else None)


def _render_gsplat(request: _Request) -> Rasterization:
    status = gsplat_backend.gsplat_status()
    if status != "works":
        raise InputError(f"splatting backend 'gsplat' cannot run here ({status}); use backend='cpu'.")
    if request.means.dtype != torch.float32 or request.means.device.type != gsplat_backend.DEVICE:
        raise InputError(
            f"splatting backend 'gsplat' takes float32 tensors on a CUDA device, got {request.means.dtype} on "
            f"{request.means.device}; convert them or use backend='cpu'."
        )
    if request.max_alpha != gsplat_backend.MAX_ALPHA:
        raise InputError(
            f"gsplat has its alpha limit compiled in as {gsplat_backend.MAX_ALPHA}, got {request.max_alpha}; leave "
            "max_alpha out or use backend='cpu'."
        )
    if request.median_depth:
        raise InputError("gsplat has no median depth of 3D Gaussians; use backend='cpu' or leave median_depth out.")
    pose = request.camera_from_world
    color, depth, alpha, extra = gsplat_backend.rasterize_gsplat(
        request.means, request.quaternions, request.log_scales, request.opacity_logits, request.colors,
        pose.reshape(-1, 4, 4), request.camera, sh=request.sh, channels=request.channels,
        centre_depth=request.centre_depth, blur_variance=request.blur_variance,
    )  # fmt: skip
    if pose.dim() == 2:
        return Rasterization(color[0], depth[0], alpha[0], None if extra is None else extra[0])
    return Rasterization(color, depth, alpha, extra)


def _render_cpu(request: _Request) -> Rasterization:
    if request.means.dtype != torch.float32 or request.means.device.type != "cpu":
        raise InputError(
            f"splatting backend 'cpu' takes float32 tensors on the CPU, got {request.means.dtype} on "
            f"{request.means.device}; use backend='reference' or convert them."
        )
    options = CpuOptions(
        request.camera, request.max_alpha, request.centre_depth, request.blur_variance, request.median_depth,
        request.threads,
    )  # fmt: skip
    return Rasterization(
        *CpuRasterization.apply(
            options, request.means, request.quaternions, request.log_scales, request.opacity_logits, request.colors,
            request.sh, request.channels, request.camera_from_world,
        )
    )  # fmt: skip


_RENDERERS = {"cpu": _render_cpu, "gsplat": _render_gsplat, "reference": _render_reference}
