import numpy as np
import pytest
import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import (
    LossWeights,
    mapping_step,
    render,
    render_depth_alpha,
    workspace,
)
from activestructure_gym.splatting.cpu import render_values
from activestructure_gym.splatting.reference import rasterize_reference
from tests.splatting.conftest import at_both_blurs

KINDS = ("random", "behind", "border", "clamped", "crowd", "needle", "flat", "large", "empty", "pixel")
RATES = np.array([2e-4] * 3 + [2e-3] * 4 + [2e-3] * 3 + [0.1] + [5e-3] * 3, np.float32)


@pytest.mark.parametrize("kind, blur_variance", at_both_blurs(KINDS))
def test_image_agrees_with_the_reference(kind, blur_variance, splats_of, settled):
    splats = splats_of(kind)
    sure = settled(splats, blur_variance=blur_variance).numpy()
    # Hardly blurred, a needle that nothing but its blur makes wide is as much sharper, and float32's rounding in it.
    close = 4e-5 if kind == "needle" and blur_variance < 0.3 else 1e-5
    assert sure.mean() > 0.8  # the comparison must not be about nothing
    color, depth, alpha = (t.detach().numpy() for t in rasterize_reference(
        *splats.tensors, splats.camera_from_world, splats.camera, blur_variance=blur_variance))  # fmt: skip
    parameters = splats.parameters(capacity=splats.means.shape[0] + 5)
    parameters[:, splats.means.shape[0] :] = np.nan  # what lies beyond count is never read
    rendering = render(
        parameters, splats.means.shape[0], splats.camera, splats.world_from_camera, blur_variance=blur_variance
    )
    assert rendering.color.dtype == np.float32 and rendering.color.shape == color.shape
    assert np.abs(rendering.color - color)[sure].max() <= close
    assert np.abs(rendering.alpha - alpha)[sure].max() <= close
    assert np.abs(rendering.depth - depth)[sure].max() <= close * max(1.0, depth.max())
    if kind != "empty":
        assert alpha.max() > 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_render_depth_alpha_is_render_for_each_camera(kind, splats_of):
    splats = splats_of(kind)
    count = splats.means.shape[0]
    parameters = splats.parameters(capacity=count + 5)
    parameters[:, count:] = np.nan  # what lies beyond count is never read
    aside, round_about = np.eye(4), np.diag([-1.0, 1.0, -1.0, 1.0])
    aside[0, 3] = 0.3
    poses = np.stack([splats.world_from_camera @ turn for turn in (round_about, np.eye(4), aside)])
    depth, alpha = render_depth_alpha(parameters, count, splats.camera, poses, threads=1)
    for index, pose in enumerate(poses):
        rendering = render(parameters, count, splats.camera, pose)
        assert np.array_equal(depth[index], rendering.depth) and np.array_equal(alpha[index], rendering.alpha)
    if kind != "empty":
        assert alpha[1].max() > 0.5 and not np.array_equal(alpha[1], alpha[2])
    for threads in (2, 3):
        again = render_depth_alpha(parameters, count, splats.camera, poses, threads=threads)
        assert np.array_equal(again[0], depth) and np.array_equal(again[1], alpha)
    none, _ = render_depth_alpha(parameters, count, splats.camera, poses[:0])
    assert none.shape == (0, splats.camera.height, splats.camera.width)


def test_render_values_blends_any_number_per_gaussian_as_render_blends_a_channel(splats_of, rng):
    splats = splats_of("crowd")
    count = splats.means.shape[0]
    parameters, values = splats.parameters(capacity=count + 5), rng.standard_normal(count).astype(np.float32)
    blended = render_values(parameters, count, splats.camera, splats.world_from_camera, values)
    parameters[11, :count] = values
    assert np.array_equal(blended[0], render(parameters, count, splats.camera, splats.world_from_camera).color[..., 0])
    assert (blended < 0).any() and (blended > 0).any()
    with pytest.raises(ValueError, match="one number per Gaussian"):
        render_values(parameters, count, splats.camera, splats.world_from_camera, values[1:])


def _targets(splats, seed=5):
    rng = np.random.default_rng(seed)
    camera = splats.camera
    target = rng.random((camera.height, camera.width, 3), dtype=np.float32)
    depth = rng.uniform(0.5, 4.0, (camera.height, camera.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    return target, depth


def ssim_torch(x, y):
    """Independent SSIM: dense 11 x 11 window, float64."""
    taps = torch.exp(-0.5 * ((torch.arange(11, dtype=torch.float64) - 5) / 1.5) ** 2)
    taps = taps / taps.sum()
    window = (taps[:, None] * taps[None]).expand(3, 1, 11, 11)

    def blur(values):
        return torch.nn.functional.conv2d(values.permute(2, 0, 1)[None], window, padding=5, groups=3)

    mx, my = blur(x), blur(y)
    vx, vy, cxy = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    return ((2 * mx * my + 1e-4) * (2 * cxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))).mean()


@pytest.mark.parametrize("normalised", [True, False])
@pytest.mark.parametrize("l1_share", [0.6, 1.0])
@pytest.mark.parametrize("kind", ["random", "border", "flat", "clamped"])
def test_mapping_step_is_autograd_plus_visible_only_adam(kind, l1_share, normalised, splats_of):
    splats = splats_of(kind, seed=2)
    weights = LossWeights(image=0.7, l1_share=l1_share, depth=0.4, alpha=0.3, normalised_depth=normalised)
    count = splats.means.shape[0]
    target, target_depth = _targets(splats)
    color, depth, alpha = rasterize_reference(*splats.tensors, splats.camera_from_world, splats.camera)
    y, d = torch.tensor(target, dtype=torch.float64), torch.tensor(target_depth, dtype=torch.float64)
    l1, ssim = (color - y).abs().mean(), ssim_torch(color, y)
    mask = (d > 0) & (alpha.detach() > 0.5) if normalised else d > 0
    share = alpha[mask] if normalised else 1.0
    depth_error = (depth[mask] / share - d[mask]).abs().sum() / (d > 0).sum()
    loss = weights.image * (weights.l1_share * l1 + (1 - weights.l1_share) * (1 - ssim)) + weights.depth * depth_error
    loss = loss + weights.alpha * ((1 - alpha) ** 2 * (d > 0)).mean()
    gradients = torch.autograd.grad(loss, splats.tensors, retain_graph=True)
    gradient = torch.cat([g if g.dim() > 1 else g[:, None] for g in gradients], dim=1).T.numpy()
    (weight_sums,) = torch.autograd.grad(color[..., 0].sum(), splats.colors)
    visible = (weight_sums[:, 0] > 0).numpy()
    assert 0.2 * count < visible.sum() <= count

    rng = np.random.default_rng(1)
    before = splats.parameters(capacity=count + 8)
    scale = np.abs(gradient).mean(axis=1, keepdims=True)  # moments of the size of the gradient make a firm test
    first, second = np.zeros_like(before), np.zeros_like(before)
    first[:, :count] = rng.normal(size=(14, count)) * scale
    second[:, :count] = (rng.uniform(0.5, 2.0, (14, count)) * scale) ** 2
    m = np.where(visible, 0.9 * first[:, :count] + 0.1 * gradient, first[:, :count])
    s = np.where(visible, 0.999 * second[:, :count] + 0.001 * gradient**2, second[:, :count])
    move = np.where(visible, RATES[:, None] * m / (np.sqrt(s) + 1e-15), 0.0)

    after = before.copy()
    losses = mapping_step(
        after, first, second, count, splats.camera, splats.world_from_camera, target, target_depth, weights=weights,
        learning_rates=RATES,
    )  # fmt: skip
    assert losses.color == pytest.approx(l1.item(), rel=1e-5)
    assert np.isnan(losses.ssim) if l1_share == 1.0 else losses.ssim == pytest.approx(ssim.item(), rel=1e-4)
    assert losses.depth == pytest.approx(depth_error.item(), rel=1e-4)
    for row in range(14):
        assert np.linalg.norm(first[row, :count] - m[row]) <= 1e-4 * np.linalg.norm(m[row])
        assert np.linalg.norm(second[row, :count] - s[row]) <= 1e-4 * np.linalg.norm(s[row])
        moved = before[row, :count].astype(np.float64) - after[row, :count]
        rounding = np.abs(before[row, :count]).max() * 1.2e-7 * np.sqrt(count)
        assert np.linalg.norm(moved - move[row]) <= 1e-4 * np.linalg.norm(move[row]) + rounding
    assert np.array_equal(after[:, count:], before[:, count:])
    assert np.array_equal(after[:, :count][:, ~visible], before[:, :count][:, ~visible])


@pytest.mark.parametrize("kind", ["random", "border", "large", "pixel", "empty"])
def test_the_fused_path_is_the_one_through_pictures(kind, splats_of, monkeypatch):
    # Many large Gaussians reach more blocks of a tile than a thread has room to keep.
    parts = [splats_of(kind, seed=seed) for seed in range(5 if kind == "large" else 1)]
    before = np.concatenate([part.parameters() for part in parts], axis=1)
    splats, count = parts[0], before.shape[1]
    target, target_depth = _targets(splats)
    results = []
    # With a trace of SSIM in it the loss is no longer pixelwise.
    for l1_share, kept in ((1.0, None), (1.0 - 1e-9, None), (1.0 - 1e-9, 0), (1.0 - 1e-9, 20_000)):
        if kept is not None:
            monkeypatch.setattr(workspace, "_MAX_KEPT", kept)
        state = [before.copy(), np.zeros_like(before), np.zeros_like(before)]
        weights = LossWeights(l1_share=l1_share, depth=0.3, alpha=0.2)
        losses = mapping_step(
            *state, count, splats.camera, splats.world_from_camera, target, target_depth, weights=weights,
            learning_rates=RATES,
        )  # fmt: skip
        results.append((losses.color, losses.depth, *state))
    fused, pictures, none_kept, some_kept = results
    for fewer in (none_kept, some_kept):
        assert all(np.array_equal(a, b) for a, b in zip(pictures, fewer))
    assert fused[:2] == pytest.approx(pictures[:2], rel=1e-6)
    for row in range(14 if count else 0):
        difference = np.linalg.norm(fused[3][row] - pictures[3][row])
        assert difference <= 1e-4 * np.linalg.norm(pictures[3][row]), row


def test_isotropic_step_is_adam_of_one_shared_log_scale(splats_of):
    splats = splats_of("random", seed=3)
    shared = splats.log_scales.detach()[:, :1].clone().requires_grad_()
    splats.log_scales = shared.expand(-1, 3)
    target, target_depth = _targets(splats)
    color, _, _ = rasterize_reference(*splats.tensors, splats.camera_from_world, splats.camera)
    loss = (color - torch.tensor(target, dtype=torch.float64)).abs().mean()
    (gradient,) = torch.autograd.grad(loss, shared)
    after = splats.parameters()
    first, second = np.zeros_like(after), np.zeros_like(after)
    arguments = (200, splats.camera, splats.world_from_camera, target, target_depth)
    weights = LossWeights(image=1.0, l1_share=1.0, depth=0.0)
    mapping_step(after, first, second, *arguments, weights=weights, learning_rates=RATES, isotropic=True)
    for row in (7, 8, 9):
        difference = np.linalg.norm(first[row] - 0.1 * gradient[:, 0].numpy())
        assert difference <= 1e-4 * np.linalg.norm(0.1 * gradient)
    assert np.abs(after[7] - splats.parameters()[7]).max() > 1e-3
    assert np.array_equal(after[7], after[8]) and np.array_equal(after[7], after[9])

    uneven = RATES.copy()
    uneven[8] = 0.1
    with pytest.raises(ValueError, match="one learning rate"):
        mapping_step(after, first, second, *arguments, weights=weights, learning_rates=uneven, isotropic=True)


@pytest.mark.parametrize("shape", [(64, 48), (70, 50), (1, 1), (33, 5)])
def test_same_bits_for_any_number_of_threads(shape, splats_of):
    splats = splats_of("random", seed=4)
    splats.camera = PinholeCamera.from_size(*shape)
    target, target_depth = _targets(splats)
    results = []
    for threads in (1, 2, 3):
        state = [splats.parameters(), np.zeros((14, 200), np.float32), np.zeros((14, 200), np.float32)]
        losses = [
            mapping_step(
                *state, 200, splats.camera, splats.world_from_camera, target, target_depth,
                weights=LossWeights(), learning_rates=RATES, threads=threads,
            )
            for _ in range(3)
        ]  # fmt: skip
        picture = render(state[0], 200, splats.camera, splats.world_from_camera, threads=threads)
        results.append((losses, *state, picture.color, picture.depth, picture.alpha))
    for other in results[1:]:
        assert other[0] == results[0][0]
        assert all(np.array_equal(a, b) for a, b in zip(other[1:], results[0][1:]))


def test_fitting_lowers_the_loss(splats_of):
    splats = splats_of("flat", seed=6)
    picture = render(splats.parameters(), 200, splats.camera, splats.world_from_camera)
    depth = np.where(picture.alpha > 0.5, picture.depth / np.maximum(picture.alpha, 1e-6), 0).astype(np.float32)
    moved = splats.parameters()
    rng = np.random.default_rng(0)
    moved[:3] += rng.normal(0, 0.01, (3, 200))
    moved[11:] += rng.normal(0, 0.2, (3, 200))
    first, second = np.zeros_like(moved), np.zeros_like(moved)
    history = [
        mapping_step(
            moved,
            first,
            second,
            200,
            splats.camera,
            splats.world_from_camera,
            picture.color,
            depth,
            weights=LossWeights(),
            learning_rates=RATES,
        )  # fmt: skip
        for _ in range(60)
    ]
    assert history[-1].color < 0.35 * history[0].color
    assert history[-1].ssim > history[0].ssim


def test_broken_gaussians_are_skipped_and_harm_nobody(splats_of):
    splats = splats_of("random")
    target, target_depth = _targets(splats)
    # In front of the others, so that they would show: not-a-number and infinity everywhere, and a zero quaternion.
    cases = [(row, value) for row in range(11) for value in (np.nan, np.inf, -np.inf)]
    # The logarithm of 0 m and the logits of 0 and 1 are not broken.
    cases = [(row, value) for row, value in cases if row < 7 or np.isnan(value) or (row < 10 and value > 0)]
    broken = splats.parameters()[:, : len(cases)]
    for column, (row, value) in enumerate(cases[:-1]):
        broken[row, column] = value
    broken[3:7, -1] = 0.0
    results = []
    for parameters in (np.concatenate([broken, splats.parameters()], axis=1), splats.parameters()):
        first, second = np.zeros_like(parameters), np.zeros_like(parameters)
        losses = mapping_step(
            parameters, first, second, parameters.shape[1], splats.camera, splats.world_from_camera, target,
            target_depth, weights=LossWeights(), learning_rates=RATES,
        )  # fmt: skip
        results.append((losses, parameters[:, -200:], first[:, -200:]))
    assert results[0][0] == results[1][0]
    assert np.array_equal(results[0][1], results[1][1]) and np.array_equal(results[0][2], results[1][2])
    assert np.isfinite(results[0][1]).all()


def test_wrong_arrays_are_refused(splats_of):
    splats = splats_of("random")
    with pytest.raises(ValueError, match="float32"):
        render(splats.parameters().astype(np.float64), 200, splats.camera, np.eye(4))
    with pytest.raises(ValueError, match="count"):
        render(splats.parameters(), 201, splats.camera, np.eye(4))
    with pytest.raises(ValueError, match="l1_share"):
        LossWeights(l1_share=1.5)
