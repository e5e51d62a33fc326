"""gsplat on a CUDA device against the float64 reference, within the tolerances of docs/notebook/groundwork.md:
pictures 2e-4 but for a thousandth of the pixels (decisions at 1/255 and 1e-4), gradients 1e-3 relative.
"""

import numpy as np
import pytest
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.splatting import LossWeights, backend_status, cpu, rasterize
from activestructure_gym.splatting.rasterizers import rasterizer

KINDS = ("random", "behind", "border", "clamped", "crowd", "needle", "flat", "large")


@pytest.fixture(scope="module")
def alpha_limit():
    """The alpha limit of the gsplat that is installed; skips where it cannot render."""
    state = backend_status()["gsplat"]
    if state != "works":
        pytest.skip(state)
    from activestructure_gym.splatting.gsplat_backend import gsplat_max_alpha

    return gsplat_max_alpha()


def _on_device(tensors):
    return [tensor.detach().float().cuda().requires_grad_() for tensor in tensors]


def _assert_pictures_agree(exact, found):
    difference = (exact.detach() - found.detach().cpu().double()).abs() / exact.detach().abs().max().clamp_min(1.0)
    assert (difference > 2e-4).double().mean() <= 1e-3
    assert torch.quantile(difference.flatten(), 0.99) < 1e-5


def _assert_gradients_agree(expected, found, names):
    for name, a, b in zip(names, expected, found):
        b = b.cpu().double()
        assert a.norm() > 1e-6, name
        assert (a - b).norm() <= 1e-3 * a.norm(), name
        assert torch.nn.functional.cosine_similarity(a.flatten(), b.flatten(), dim=0) > 0.9999, name


@pytest.mark.gpu
@pytest.mark.parametrize("kind", KINDS)
def test_pictures_and_gradients(kind, alpha_limit, splats_of, settled):
    splats = splats_of(kind, seed=1)
    sure = settled(splats, max_alpha=alpha_limit)
    generator = torch.Generator().manual_seed(0)
    by_color = torch.randn(*sure.shape, 3, generator=generator, dtype=torch.float64) * sure[..., None]
    by_depth, by_alpha = (torch.randn(*sure.shape, generator=generator, dtype=torch.float64) * sure for _ in range(2))
    leaves = [*splats.tensors, splats.camera_from_world]
    results = []
    for backend, own in (("reference", leaves), ("gsplat", _on_device(leaves))):
        out = rasterize(
            *own[:5], camera_from_world=own[5], camera=splats.camera, backend=backend, max_alpha=alpha_limit
        )
        loss = sum((picture * weight.to(picture)).sum() for picture, weight in
                   ((out.color, by_color), (out.depth, by_depth), (out.alpha, by_alpha)))  # fmt: skip
        results.append((out, torch.autograd.grad(loss, own)))
    (exact, expected), (found, gradients) = results
    for name in ("color", "depth", "alpha"):
        _assert_pictures_agree(getattr(exact, name), getattr(found, name))
    names = ("mean", "quaternion", "log-scale", "opacity", "color", "pose")
    _assert_gradients_agree(expected, gradients, names)


@pytest.mark.gpu
@pytest.mark.parametrize("depth", (0, 5, 40))  # 40: more channels than gsplat blends at once
@pytest.mark.parametrize("terms", (1, 4, 9, 16))
def test_harmonics_channels_and_several_cameras(terms, depth, alpha_limit, splats_of, settled):
    splats = splats_of("random", seed=2)
    generator = torch.Generator().manual_seed(0)
    count = len(splats.means)
    sh = (0.3 * torch.randn(count, terms, 3, generator=generator)).double().requires_grad_()
    extra = [torch.randn(count, depth, generator=generator).double().requires_grad_()] if depth else []
    poses = torch.stack([splats.camera_from_world.detach()] * 2)
    poses[1, 0, 3] += 0.25
    poses.requires_grad_()
    sure = settled(splats, max_alpha=alpha_limit)
    leaves = [*splats.tensors[:4], sh, poses, *extra]
    results = []
    for backend, own in (("reference", leaves), ("gsplat", _on_device(leaves))):
        out = rasterize(
            *own[:4], sh=own[4], camera_from_world=own[5], camera=splats.camera, backend=backend,
            max_alpha=alpha_limit, channels=own[6] if depth else None,
        )  # fmt: skip
        pictures = [out.color, *([out.channels] if depth else [])]
        mask = sure.to(out.color.device)[..., None]
        loss = sum((picture[0] * mask).square().sum() for picture in pictures)
        results.append((pictures, torch.autograd.grad(loss, own)))
    (exact, expected), (found, gradients) = results
    for a, b in zip(exact, found):
        assert a.shape == b.shape
        _assert_pictures_agree(a, b)
    _assert_gradients_agree(
        expected, gradients, ("mean", "quaternion", "log-scale", "opacity", "sh", "pose", "channels")
    )


@pytest.mark.gpu
def test_what_gsplat_cannot_do_is_said(alpha_limit, splats_of):
    splats = splats_of("random")
    own = _on_device([*splats.tensors, splats.camera_from_world])
    with pytest.raises(InputError, match="median"):
        rasterize(*own[:5], camera_from_world=own[5], camera=splats.camera, max_alpha=alpha_limit, median_depth=True)
    with pytest.raises(InputError, match="compiled in"):
        rasterize(*own[:5], camera_from_world=own[5], camera=splats.camera, max_alpha=0.5)


@pytest.mark.gpu
@pytest.mark.parametrize("normalised", [True, False])
def test_a_mapping_step_is_the_kernels(normalised, alpha_limit, splats_of):
    splats = splats_of("random", seed=3)  # no opacity reaches the limit of any version
    count, camera, pose = len(splats.means), splats.camera, splats.world_from_camera
    rng = np.random.default_rng(0)
    target = rng.random((camera.height, camera.width, 3), dtype=np.float32)
    depth = rng.uniform(0.5, 4.0, (camera.height, camera.width)).astype(np.float32)
    weights = LossWeights(alpha=0.3, normalised_depth=normalised)
    states, losses = [], []
    for one in (cpu, rasterizer("gsplat")):
        state = [splats.parameters(), *(np.zeros((14, count), np.float32) for _ in range(2))]
        rates = np.full(14, 1e-3, np.float32)
        losses.append(
            one.mapping_step(*state, count, camera, pose, target, depth, weights=weights, learning_rates=rates)
        )
        states.append(state)
    kernels, gsplat = losses
    assert (gsplat.color, gsplat.depth, gsplat.ssim) == pytest.approx(
        (kernels.color, kernels.depth, kernels.ssim), rel=1e-3
    )
    for row in range(14):
        by_kernels, by_gsplat = states[0][1][row], states[1][1][row]
        assert np.linalg.norm(by_gsplat - by_kernels) <= 1e-3 * np.linalg.norm(by_kernels), row
