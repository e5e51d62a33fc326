import numpy as np
import pytest
import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import rasterize
from activestructure_gym.splatting.passes import median_gaussian
from activestructure_gym.splatting.reference import MIN_ALPHA, MIN_TRANSMITTANCE, project_gaussians
from activestructure_gym.splatting.workspace import Workspace, fitted

KINDS = ("random", "behind", "border", "clamped", "crowd", "needle", "flat", "large", "empty", "pixel")


def _single(tensors):
    return [tensor.detach().float().requires_grad_() for tensor in tensors]


def _far_from_half(splats, slack=1e-4):  # [H, W] bool
    """Pixels in which no transmittance is so near 0.5 that float32 may decide differently."""
    with torch.no_grad():
        position, inverse, depth = project_gaussians(*splats.tensors[:3], splats.camera_from_world, splats.camera)
        order = torch.argsort(depth)
        order = order[depth[order] >= 0.01]
        v, u = torch.meshgrid(
            torch.arange(splats.camera.height) + 0.5, torch.arange(splats.camera.width) + 0.5, indexing="ij"
        )
        dx, dy = u[..., None] - position[order, 0], v[..., None] - position[order, 1]
        a, b, c = inverse[order].T
        alpha = torch.sigmoid(splats.opacity_logits[order]) * torch.exp(-0.5 * (a * dx**2 + c * dy**2) - b * dx * dy)
        alpha = torch.where(alpha < MIN_ALPHA, 0.0, alpha.clamp(max=0.999))
        after = torch.cumprod(1 - alpha, dim=2)
        return ~((after - 0.5).abs() < slack).any(dim=2)


@pytest.mark.parametrize("kind", KINDS)
def test_median_depth_agrees_with_the_reference(kind, splats_of, settled):
    splats = splats_of(kind, seed=4)
    sure = settled(splats) & _far_from_half(splats)
    assert sure.double().mean() > 0.8
    exact = rasterize(
        *splats.tensors, camera_from_world=splats.camera_from_world, camera=splats.camera, median_depth=True
    )
    *tensors, pose = _single((*splats.tensors, splats.camera_from_world))
    found = rasterize(*tensors, camera_from_world=pose, camera=splats.camera, median_depth=True)
    assert (exact.median_depth - found.median_depth)[sure].abs().max() <= 1e-5 * 5.0
    assert not found.median_depth.requires_grad and not exact.median_depth.requires_grad
    open_pixels = (found.alpha < 0.5) & sure
    assert (found.median_depth[open_pixels] == 0).all()
    assert (found.median_depth[sure & ~open_pixels] > 0).all()
    without = rasterize(*tensors, camera_from_world=pose, camera=splats.camera)
    assert without.median_depth is None and torch.equal(without.color, found.color)


@pytest.mark.parametrize("kind", KINDS)
def test_the_median_needs_no_blending(kind, splats_of):
    splats, workspace = splats_of(kind, seed=4), Workspace()
    block = fitted(splats.parameters())
    given = (block, len(splats.tensors[0]), splats.camera, splats.camera_from_world.detach().numpy())
    workspace.render(*given, keep=False)
    blended = median_gaussian(workspace)
    workspace.prepare(*given)
    assert np.array_equal(median_gaussian(workspace, blended=False), blended)


@pytest.mark.parametrize("dtype", (torch.float32, torch.float64))
def test_median_depth_by_hand(dtype):
    # Three of alpha 0.4 at 1, 2, 3 m: transmittance 0.6, 0.36, ... so the second. At alpha 0.1 each none.
    means = torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]], dtype=dtype)
    turns, sizes = torch.tensor([[1.0, 0, 0, 0]] * 3, dtype=dtype), torch.full((3, 3), -2.0, dtype=dtype)
    camera = PinholeCamera(1, 1, 20.0, 20.0, 0.5, 0.5)
    for alpha, expected in ((0.4, 2.0), (0.1, 0.0), (0.6, 1.0)):
        logits = torch.logit(torch.full((3,), alpha, dtype=dtype))
        out = rasterize(
            means, turns, sizes, logits, torch.ones_like(means), camera_from_world=torch.eye(4, dtype=dtype),
            camera=camera, median_depth=True,
        )  # fmt: skip
        assert out.median_depth.item() == expected


@pytest.mark.parametrize("depth", (1, 3, 5))
@pytest.mark.parametrize("kind", ("random", "clamped", "large", "pixel"))
def test_channels_agree_with_the_reference(kind, depth, splats_of, settled):
    splats = splats_of(kind, seed=6)
    sure = settled(splats)
    generator = torch.Generator().manual_seed(1)
    channels = torch.randn(len(splats.means), depth, generator=generator).double().requires_grad_()
    by_color, by_channels = (torch.randn(*sure.shape, d, generator=generator) * sure[..., None] for d in (3, depth))
    results = []
    for backend in ("reference", "cpu"):
        leaves = [*splats.tensors, channels, splats.camera_from_world]
        if backend == "cpu":
            leaves = _single(leaves)
        *tensors, extra, pose = leaves
        out = rasterize(*tensors, channels=extra, camera_from_world=pose, camera=splats.camera, backend=backend)
        loss = (out.color * by_color).sum() + (out.channels * by_channels).sum()
        results.append((out.channels, torch.autograd.grad(loss, leaves, retain_graph=True)))
        if backend == "cpu":  # the records are as before, so that the graph can be used again
            again = torch.autograd.grad(loss, leaves)
            assert all(torch.equal(a, b) for a, b in zip(again, results[-1][1]))
    (exact, expected), (found, gradients) = results
    assert found.shape == (*sure.shape, depth)
    assert (exact - found)[sure].abs().max() <= 1e-5 * exact.abs().max().clamp_min(1.0)
    for a, b in zip(expected, gradients):
        assert a.norm() > 1e-6
        assert (a - b).norm() <= 1e-4 * a.norm()


def test_channels_that_are_colors_are_the_color(splats_of):
    splats = splats_of("random", seed=7)
    *tensors, pose = _single((*splats.tensors, splats.camera_from_world))
    out = rasterize(*tensors, channels=tensors[4].flip(1), camera_from_world=pose, camera=splats.camera)
    assert torch.equal(out.channels, out.color.flip(-1))
    alone = rasterize(*tensors, camera_from_world=pose, camera=splats.camera)
    assert alone.channels is None
    for name in ("color", "depth", "alpha"):
        assert torch.equal(getattr(alone, name), getattr(out, name))


def test_stopping_threshold_is_not_crossed_by_the_median():
    # alpha 0.45 leaves 0.55; the next of 0.99995 would leave 2.75e-5 <= 1e-4, so it is no part of the pixel.
    assert 0.55 * (1 - 0.99995) < MIN_TRANSMITTANCE
    means = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    out = rasterize(
        means, torch.tensor([[1.0, 0, 0, 0]] * 2), torch.full((2, 3), -2.0),
        torch.tensor([float(torch.logit(torch.tensor(0.45))), 20.0]), torch.ones(2, 3),
        camera_from_world=torch.eye(4), camera=PinholeCamera(1, 1, 20.0, 20.0, 0.5, 0.5), max_alpha=0.99995,
        median_depth=True,
    )  # fmt: skip
    assert out.alpha.item() == pytest.approx(0.45, abs=1e-6) and out.median_depth.item() == 0.0
