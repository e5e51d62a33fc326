"""The second pass against autograd Jacobians in float64, and its sums against brute force over all pixels."""

import math

import numpy as np
import pytest
import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import fisher_kernels, render
from activestructure_gym.splatting.benchmark import make_workload
from activestructure_gym.splatting.fisher import DIAGONAL, full_blocks, view_information
from activestructure_gym.splatting.reference import MIN_ALPHA, MIN_TRANSMITTANCE, project_gaussians, rasterize_reference

KINDS = ("random", "behind", "border", "clamped", "needle", "flat", "large", "pixel", "empty")


def few(splats_of, kind, count=40):
    """A small picture of few Gaussians: every Jacobian is made."""
    splats = splats_of(kind, seed=3)
    if kind != "pixel":
        splats.camera = PinholeCamera(14, 11, 9.0, 9.5, 6.7, 5.8)
    for name in ("means", "quaternions", "log_scales", "opacity_logits", "colors"):
        setattr(splats, name, getattr(splats, name).detach()[:count].clone().requires_grad_())
    return splats


def all_weights(splats, max_alpha=0.999):
    """Weight and transmittance in front ``[H * W, N]`` of every Gaussian in every pixel, from the formulas."""
    camera = splats.camera
    with torch.no_grad():
        position, inverse, depth = project_gaussians(*splats.tensors[:3], splats.camera_from_world, camera)
        order = torch.argsort(depth, stable=True)
        rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
        dx, dy = columns.reshape(-1, 1) + 0.5 - position[:, 0], rows.reshape(-1, 1) + 0.5 - position[:, 1]
        power = -0.5 * (inverse[:, 0] * dx**2 + inverse[:, 2] * dy**2) - inverse[:, 1] * dx * dy
        alpha = (torch.sigmoid(splats.opacity_logits) * power.exp()).clamp(max=max_alpha)
        alpha = torch.where((alpha < MIN_ALPHA) | (depth < 0.01), 0.0, alpha)
        left, open_ = torch.ones(len(alpha), dtype=torch.float64), torch.ones(len(alpha), dtype=bool)
        weight, before = torch.zeros_like(alpha), torch.zeros_like(alpha)
        for i in order:
            open_ &= left * (1 - alpha[:, i]) > MIN_TRANSMITTANCE
            share = torch.where(open_, alpha[:, i], 0.0)
            weight[:, i], before[:, i] = share * left, left
            left = left * (1 - share)
    return weight.numpy(), before.numpy()


def jacobian(splats):
    """Colours by (mean, log-scale, logit): [H * W * 3, N, 7]."""
    color, _, _ = rasterize_reference(*splats.tensors, splats.camera_from_world, splats.camera)
    rows, parts = torch.eye(color.numel(), dtype=torch.float64).reshape(-1, *color.shape), []
    leaves = (splats.means, splats.log_scales, splats.opacity_logits)
    for some in rows.split(128):
        by = torch.autograd.grad(color, leaves, some, retain_graph=True, is_grads_batched=True)
        parts.append(torch.cat([by[0], by[1], by[2][..., None]], dim=-1))
    return torch.cat(parts).numpy()


def sure_of(splats, settled, weight):
    """Gaussians that share no pixel with a decision which float32 and float64 may take differently."""
    doubtful = ~settled(splats).numpy().reshape(-1)
    return (weight.sum(axis=0) > 0) & ~(weight[doubtful] > 0).any(axis=0)


def one_view(splats, **options):
    parameters = splats.parameters(capacity=splats.means.shape[0] + 5)
    return next(
        view_information(parameters, splats.means.shape[0], splats.camera, splats.world_from_camera, **options)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_blocks_are_those_of_autograd(kind, splats_of, settled):
    splats = few(splats_of, kind)
    found = one_view(splats)
    if kind == "empty":
        assert found.numbers.shape == (0, 26) and found.color.max() == 0.0
        return
    weight, _ = all_weights(splats)
    sure = sure_of(splats, settled, weight)[found.indices]
    assert sure.sum() >= (1 if kind == "pixel" else 10)
    by = jacobian(splats)[:, found.indices]
    exact = np.einsum("pni,pnj->nij", by, by)
    own = np.sqrt(np.einsum("nii->ni", exact)).clip(1e-30)
    error = np.zeros_like(exact)
    error[:, :6, :6] = full_blocks(found.blocks) - exact[:, :6, :6]
    error[:, 6, 6] = found.logits - exact[:, 6, 6]
    error = np.abs(error / (own[:, :, None] * own[:, None, :]))[sure]
    print(kind, sure.sum(), error.max(), np.median(error.max(axis=(1, 2))))
    total = np.linalg.norm((full_blocks(found.blocks) - exact[:, :6, :6])[sure]) / np.linalg.norm(exact[sure, :6, :6])
    print("  norm", total)


@pytest.mark.parametrize("kind", ["random", "behind", "border", "clamped", "pixel"])
def test_sums_are_those_over_all_pixels(kind, splats_of, settled):
    splats = few(splats_of, kind)
    rng, count = np.random.default_rng(0), splats.means.shape[0]
    values = rng.random((splats.camera.height, splats.camera.width), dtype=np.float32)
    channels = rng.random((count, 5), dtype=np.float32)
    found = one_view(splats, channels=channels, pixel_values=values, touch_transmittance=0.3)
    weight, before = all_weights(splats)
    sure = sure_of(splats, settled, weight)
    assert np.array_equal(found.indices[sure[found.indices]], np.flatnonzero(sure))
    here, counts = np.flatnonzero(sure), (weight > 0) & (before > 0.3)
    mine = np.flatnonzero(sure[found.indices])
    assert found.weights[mine] == pytest.approx(weight.sum(axis=0)[here], rel=1e-5)
    assert found.colors[mine] == pytest.approx((weight**2).sum(axis=0)[here], rel=1e-5)
    near = (np.abs(before - 0.3) < 1e-5).any(axis=0)[here]
    assert near.sum() < 3
    assert np.array_equal(found.touches[mine][~near], counts.sum(axis=0)[here][~near])
    gathered = (weight * counts * values.reshape(-1, 1)).sum(axis=0)[here]
    assert found.gathered[mine][~near] == pytest.approx(gathered[~near], rel=1e-5)
    picture = (weight @ channels).reshape(found.channels.shape)
    certain = settled(splats).numpy()
    assert np.abs(found.channels - picture)[certain].max() < 1e-5
