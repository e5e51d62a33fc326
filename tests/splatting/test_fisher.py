"""The second pass against autograd Jacobians in float64, and its sums against brute force over all pixels."""

import numpy as np
import pytest
import torch

from activestructure_gym.evaluation.benchmarks.workload import make_workload
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import fisher_kernels, layout, render
from activestructure_gym.splatting.fisher import DIAGONAL, depth_information, full_blocks, view_information
from activestructure_gym.splatting.reference import MIN_ALPHA, MIN_TRANSMITTANCE, project_gaussians, rasterize_reference
from activestructure_gym.splatting.simd import LANES

KINDS = ("random", "behind", "border", "clamped", "needle", "flat", "large", "pixel", "empty")


# Of float32 in squares of what a Gaussian shows that is hardly blurred: 1e-5 at a blur of .3 px^2.
ROUNDING = 4e-5


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
    return next(view_information(parameters, splats.means.shape[0], splats.camera, splats.world_from_camera, **options))


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
    exact = np.einsum("pni,pnj->nij", by, by)[sure]
    error = full_blocks(found.blocks)[sure] - exact[:, :6, :6]

    def share(part):
        sizes = [np.linalg.norm(array[:, part, part], axis=(1, 2)) for array in (error, exact)]
        return sizes[0] / sizes[1]

    # Of every single block; and the mean and the log-scale alone, which have other units.
    assert share(slice(6)).max() <= ROUNDING
    for part in (slice(3), slice(3, 6)):
        assert share(part).max() <= 3 * ROUNDING and np.median(share(part)) <= 0.5 * ROUNDING
    logits = np.abs(found.logits[sure] / exact[:, 6, 6] - 1.0)
    assert logits.max() <= 3 * ROUNDING and np.median(logits) <= 0.5 * ROUNDING


def depth_jacobians(splats):
    """Accumulated depth by (mean, log-scale, logit), [H * W, N, 7]: through the weights; by the mean's own depth."""
    camera_from_world = splats.camera_from_world
    own_depths = (splats.means @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])[:, 2]

    def of(depths):
        painted = torch.stack([depths] * 3, dim=1)
        color, _, _ = rasterize_reference(*splats.tensors[:4], painted, camera_from_world, splats.camera)
        picture = color[..., 0].reshape(-1)
        leaves = (splats.means, splats.log_scales, splats.opacity_logits)
        rows = torch.eye(picture.numel(), dtype=torch.float64)
        by = torch.autograd.grad(picture, leaves, rows, retain_graph=True, is_grads_batched=True)
        return torch.cat([by[0], by[1], by[2][..., None]], dim=-1).numpy()

    whole, through_weights = of(own_depths), of(own_depths.detach())
    return through_weights, whole - through_weights


@pytest.mark.parametrize("kind", ["random", "border", "flat", "large"])
def test_depth_blocks_are_those_of_autograd_but_for_the_product_of_the_two_ways(kind, splats_of, settled):
    splats = few(splats_of, kind)
    count = splats.means.shape[0]
    parameters = splats.parameters(capacity=count + 5)
    found = depth_information(parameters, count, splats.camera, splats.world_from_camera)
    weight, _ = all_weights(splats)
    sure = sure_of(splats, settled, weight)[found.indices]
    through, own = (by[:, found.indices][:, sure] for by in depth_jacobians(splats))
    exact = np.einsum("pni,pnj->nij", through, through) + np.einsum("pni,pnj->nij", own, own)
    error = full_blocks(found.blocks)[sure] - exact[:, :6, :6]
    for part in (slice(3), slice(3, 6)):
        sizes = [np.linalg.norm(array[:, part, part], axis=(1, 2)) for array in (error, exact)]
        assert (sizes[0] <= 1e-4 * sizes[1] + 1e-9).all()
    logits = exact[:, 6, 6]
    assert np.abs(found.logits[sure] - logits).max() <= 1e-4 * logits.max()
    # What is left out, of the whole: the trace of the mean's block over all Gaussians.
    whole = ((through + own)[..., :3] ** 2).sum()
    assert np.trace(exact[:, :3, :3], axis1=1, axis2=2).sum() == pytest.approx(whole, rel=0.15)


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
    assert found.weights[mine] == pytest.approx(weight.sum(axis=0)[here], rel=ROUNDING)
    assert found.colors[mine] == pytest.approx((weight**2).sum(axis=0)[here], rel=3 * ROUNDING)
    near = (np.abs(before - 0.3) < 1e-5).any(axis=0)[here]
    assert near.sum() < 3
    assert np.array_equal(found.touches[mine][~near], counts.sum(axis=0)[here][~near])
    gathered = (weight * counts * values.reshape(-1, 1)).sum(axis=0)[here]
    assert found.gathered[mine][~near] == pytest.approx(gathered[~near], rel=ROUNDING)
    picture = (weight @ channels).reshape(found.channels.shape)
    certain = settled(splats).numpy()
    assert np.abs(found.channels - picture)[certain].max() < 1e-5


def test_pictures_are_those_of_render_and_all_cameras_come_one_by_one(splats_of):
    splats = splats_of("random")
    turn = np.eye(4)
    turn[0, 3] = 0.3
    poses = np.stack([splats.world_from_camera, splats.world_from_camera @ turn])
    views = list(view_information(splats.parameters(), 200, splats.camera, poses))
    for pose, view in zip(poses, views):
        rendering = render(splats.parameters(), 200, splats.camera, pose)
        for name in ("color", "depth", "alpha"):
            assert np.array_equal(getattr(view, name), getattr(rendering, name))
        (again,) = view_information(splats.parameters(), 200, splats.camera, pose)
        assert np.array_equal(again.numbers, view.numbers)
    assert len(views[0].indices) != len(views[1].indices) or not np.array_equal(views[0].numbers, views[1].numbers)
    assert views[0].channels.shape == (50, 70, 0) and views[0].gathered.max() == 0.0
    assert list(view_information(splats.parameters(), 200, splats.camera, poses[:0])) == []


def test_same_bits_for_any_number_of_threads():
    work = make_workload("W1")
    channels = np.random.default_rng(0).random((work.count, 2), dtype=np.float32)
    results = [
        next(
            view_information(
                work.parameters, work.count, work.camera, work.poses[0], channels=channels,
                pixel_values=work.target_depth, threads=threads,
            )
        )
        for threads in (1, 2, 3)
    ]  # fmt: skip
    assert len(results[0].indices) > 5000
    for other in results[1:]:
        for name in ("color", "depth", "alpha", "channels", "indices", "numbers"):
            assert np.array_equal(getattr(other, name), getattr(results[0], name)), name
    assert len(fisher_kernels.inform.signatures) == 1
    traces = results[0].blocks[:, DIAGONAL]
    assert (traces >= 0).all() and (traces.sum(axis=1) > 0).mean() > 0.99


def test_a_tile_with_more_alphas_than_fit_is_the_same(splats_of, monkeypatch):
    # Five layers of large Gaussians; with shorter chunks of scratch nothing may change.
    parts = [splats_of("large", seed=seed) for seed in range(5)]
    parameters = np.concatenate([part.parameters() for part in parts], axis=1)
    splats = parts[0]
    blocks = 64 * parameters.shape[1]  # at most
    assert blocks * LANES > layout.SCRATCH - fisher_kernels._STATE
    view = next(view_information(parameters, parameters.shape[1], splats.camera, splats.world_from_camera))
    rendering = render(parameters, parameters.shape[1], splats.camera, splats.world_from_camera)
    assert np.array_equal(view.color, rendering.color)
    # The weights of all Gaussians are the opacity of all pixels.
    assert view.weights.sum() == pytest.approx(rendering.alpha.sum(), rel=1e-5)


def test_nothing_is_told_of_what_lies_behind(splats_of):
    splats = splats_of("random")
    behind = splats.world_from_camera @ np.diag([-1.0, 1.0, -1.0, 1.0])
    (view,) = view_information(splats.parameters(), 200, splats.camera, behind)
    assert view.numbers.shape == (0, 26) and view.alpha.max() == 0.0


def test_arrays_that_do_not_fit_are_named(splats_of):
    splats = splats_of("random")
    arguments = (splats.parameters(), 200, splats.camera, splats.world_from_camera)
    with pytest.raises(ValueError, match=r"channels must have the shape \[200, D\]"):
        view_information(*arguments, channels=np.zeros((199, 1), np.float32))
    with pytest.raises(ValueError, match="pixel_values"):
        view_information(*arguments, pixel_values=np.zeros((5, 5), np.float32))
    with pytest.raises(ValueError, match="parameters"):
        view_information(arguments[0][:13], *arguments[1:])
