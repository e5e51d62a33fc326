import subprocess
import sys

import numpy as np
import pytest
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, se3_exp
from activestructure_gym.splatting import camera_twist_gradient, parameter_rows, rasterize
from activestructure_gym.splatting.backends import BACKENDS, backend_status
from activestructure_gym.splatting.packing import packed
from tests.splatting.conftest import at_both_blurs

KINDS = ("random", "behind", "border", "clamped", "crowd", "needle", "flat", "large", "pixel")


def _single(splats):
    return [tensor.detach().float().requires_grad_() for tensor in (*splats.tensors, splats.camera_from_world)]


@pytest.mark.parametrize("kind, blur_variance", at_both_blurs(KINDS))
def test_cpu_gradients_agree_with_the_reference(kind, blur_variance, splats_of, settled):
    splats = splats_of(kind, seed=1)
    sure = settled(splats, blur_variance=blur_variance)
    close = 1e-3 if kind == "needle" and blur_variance < 0.3 else 1e-4  # float32's rounding in what is so sharp
    assert sure.double().mean() > 0.8
    generator = torch.Generator().manual_seed(0)
    height, width = sure.shape
    by_color = torch.randn(height, width, 3, generator=generator) * sure[..., None]
    by_depth, by_alpha = (torch.randn(height, width, generator=generator) * sure for _ in range(2))

    def gradients(inputs, backend):
        *tensors, pose = inputs
        out = rasterize(
            *tensors, camera_from_world=pose, camera=splats.camera, blur_variance=blur_variance, backend=backend
        )
        loss = (out.color * by_color).sum() + (out.depth * by_depth).sum() + (out.alpha * by_alpha).sum()
        return torch.autograd.grad(loss, inputs)

    expected = gradients([*splats.tensors, splats.camera_from_world], "reference")
    found = gradients(_single(splats), "cpu")
    for name, a, b in zip(("mean", "quaternion", "log-scale", "opacity", "color", "pose"), expected, found):
        assert a.norm() > 1e-6, name
        assert (a - b).norm() <= close * a.norm(), name


def _everything(splats, seed=0):
    """Single precision leaves (geometry, harmonics, channels) and what else `rasterize` takes."""
    generator = torch.Generator().manual_seed(seed)
    count = len(splats.means)
    leaves = [tensor.detach().float() for tensor in splats.tensors[:4]]
    leaves += [torch.randn(count, 9, 3, generator=generator) * 0.3, torch.randn(count, 4, generator=generator)]
    return [leaf.requires_grad_() for leaf in leaves]


def _render_everything(leaves, pose, splats, **options):
    *geometry, sh, channels = leaves
    return rasterize(
        *geometry, sh=sh, channels=channels, camera_from_world=pose, camera=splats.camera, median_depth=True, **options
    )


def _loss(out):
    """Another weight for every number, so that no mix-up cancels."""
    total = 0.0
    for picture in (out.color, out.depth, out.alpha, out.channels):
        total = total + (picture * torch.linspace(-1.0, 2.0, picture.numel()).reshape(picture.shape)).sum()
    return total


PICTURES = ("color", "depth", "alpha", "channels", "median_depth")


@pytest.mark.parametrize("backend", ("cpu", "reference"))
def test_cameras_together_are_the_cameras_alone(backend, splats_of):
    splats = splats_of("clamped")
    leaves = _everything(splats)
    poses = torch.stack([splats.camera_from_world.detach().float()] * 3)
    poses[1, 0, 3] += 0.2
    poses[2, :3] = torch.tensor(se3_exp(np.array([0.0, 0.1, 0.0, 0.1, 0.2, 0.0])) @ poses[2].double().numpy())[:3]
    together = poses.clone().requires_grad_()
    out = _render_everything(leaves, together, splats, backend=backend, max_alpha=0.9)
    assert out.color.shape == (3, 50, 70, 3) and out.depth.shape == out.median_depth.shape == (3, 50, 70)
    assert out.channels.shape == (3, 50, 70, 4)
    weights = torch.linspace(0.0, 1.0, out.color.numel()).reshape(out.color.shape)
    shares = torch.linspace(1.0, 0.0, out.channels.numel()).reshape(out.channels.shape)
    loss = (out.color * weights).sum() + (out.channels * shares).sum()
    gradients = torch.autograd.grad(loss, [*leaves, together])
    summed = [torch.zeros_like(gradient) for gradient in gradients[:-1]]
    for index in range(3):
        pose = poses[index].clone().requires_grad_()
        one = _render_everything(leaves, pose, splats, backend=backend, max_alpha=0.9)
        for name in PICTURES:
            assert torch.equal(getattr(one, name), getattr(out, name)[index]), name
        own = (one.color * weights[index]).sum() + (one.channels * shares[index]).sum()
        *parts, by_pose = torch.autograd.grad(own, [*leaves, pose])
        assert torch.equal(by_pose, gradients[-1][index])
        summed = [a + b for a, b in zip(summed, parts)]
    for a, b in zip(summed, gradients):
        assert a.norm() > 0 and (a - b).norm() <= 1e-6 * a.norm()
    assert torch.allclose(out.expected_depth, out.depth / out.alpha.clamp_min(1e-10))


@pytest.mark.parametrize("size", [(70, 50), (33, 5), (1, 1)])
def test_same_bits_for_any_number_of_threads(size, splats_of):
    splats = splats_of("large", seed=3)
    splats.camera = PinholeCamera.from_size(*size)
    results = []
    for threads in (1, 2, 3):
        leaves, pose = _everything(splats), splats.camera_from_world.detach().float().requires_grad_()
        out = _render_everything(leaves, pose, splats, threads=threads)
        gradients = torch.autograd.grad(_loss(out), [*leaves, pose])
        results.append([*(getattr(out, name) for name in PICTURES), *gradients])
    assert results[0][0].abs().sum() > 0
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other))


@pytest.mark.parametrize("backend", ("cpu", "reference"))
def test_twist_gradient_against_finite_differences(backend, splats_of):
    splats = splats_of("large", seed=2)  # nearly no pixel lies on the 1/255 border of one
    leaves = [leaf.detach() for leaf in _everything(splats)]
    exact = [leaf.double() for leaf in leaves]
    pose = splats.camera_from_world.detach()

    def loss(leaves, pose, backend):
        return _loss(_render_everything(leaves, pose, splats, backend=backend))

    dtype = torch.float32 if backend == "cpu" else torch.float64
    own = pose.to(dtype).requires_grad_()
    (gradient,) = torch.autograd.grad(loss(leaves if backend == "cpu" else exact, own, backend), own)
    twist = camera_twist_gradient(own, gradient)
    assert twist.shape == (6,) and gradient[3].abs().sum() == 0
    numeric, step = torch.zeros(6, dtype=torch.float64), 1e-7
    for axis in range(6):
        for sign in (1, -1):
            moved = torch.tensor(se3_exp(sign * step * np.eye(6)[axis])) @ pose
            numeric[axis] += sign * loss(exact, moved, "reference") / (2 * step)
    assert (twist - numeric).norm() <= (1e-4 if backend == "cpu" else 1e-5) * numeric.norm()
    assert (numeric.abs() > 1e-4 * numeric.norm()).all()
    many = camera_twist_gradient(torch.stack([own, own]), torch.stack([gradient, 2 * gradient]))
    assert torch.allclose(many[1], 2 * twist)


def test_losses_that_use_little_and_maps_that_are_empty(splats_of):
    splats = splats_of("random")
    leaves = _single(splats)

    def render(inputs, **options):
        return rasterize(*inputs[:5], camera_from_world=inputs[5], camera=splats.camera, **options)

    full = render(leaves)
    expected = torch.autograd.grad(full.depth.sum() + 0.0 * full.color.sum() + 0.0 * full.alpha.sum(), leaves)
    found = torch.autograd.grad(render(leaves).depth.sum(), leaves)
    assert all(torch.equal(a, b) for a, b in zip(expected, found))
    fixed = [leaf.detach() for leaf in leaves[:5]]
    (alone,) = torch.autograd.grad(render([*fixed, leaves[5]]).depth.sum(), leaves[5])
    assert torch.equal(alone, expected[5])
    extra = torch.randn(len(splats.means), 2)
    found = torch.autograd.grad(render(leaves, channels=extra).channels.sum(), leaves[:4] + leaves[5:])
    assert all(gradient.norm() > 0 for gradient in found)
    with torch.no_grad():
        assert torch.equal(render(leaves).color, full.color.detach())
    empty = _single(splats_of("empty"))
    out = render(empty, channels=torch.zeros(0, 2), median_depth=True)
    gradients = torch.autograd.grad(out.color.sum() + out.channels.sum(), empty)
    assert out.color.abs().sum() + out.median_depth.sum() == 0 and gradients[0].shape == (0, 3)
    sh = torch.zeros(0, 16, 3, requires_grad=True)
    out = rasterize(*empty[:4], sh=sh, camera_from_world=empty[5], camera=splats.camera)
    assert torch.autograd.grad(out.color.sum(), sh)[0].shape == (0, 16, 3)


def test_rows_of_one_array_go_in_and_out_without_a_copy(splats_of):
    splats = splats_of("random", seed=8)
    leaves = _single(splats)
    count = 192  # a multiple of 16
    leaves = [leaf.detach()[:count].clone().requires_grad_() for leaf in leaves[:5]] + leaves[5:]
    block = torch.cat([leaf.detach() if leaf.dim() > 1 else leaf.detach()[:, None] for leaf in leaves[:5]], 1).T
    rows = [row.requires_grad_() for row in parameter_rows(block.contiguous())]

    def backward(tensors):
        out = rasterize(*tensors, camera_from_world=leaves[5], camera=splats.camera)
        out.color.square().sum().backward()

    backward(leaves[:5])
    backward([row.T if row.dim() == 2 else row for row in rows])
    for leaf, row in zip(leaves, rows):
        assert row.grad.norm() > 0 and torch.equal(leaf.grad, row.grad.T if row.dim() == 2 else row.grad)
    assert packed(tuple(row.detach().T if row.dim() == 2 else row.detach() for row in rows), 1).ctypes.data == (
        rows[0].data_ptr()
    )
    storages = {row.grad.untyped_storage().data_ptr() for row in rows}
    assert len(storages) == 1 and all(row.grad.is_contiguous() for row in rows)
    for own, fused in ((rows, True), (leaves[:5], False)):
        torch.optim.Adam(own, lr=0.01, fused=fused).step()
    for leaf, row in zip(leaves, rows):
        assert torch.allclose(leaf, row.T if row.dim() == 2 else row, atol=1e-6)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        out = rasterize(*[row.T if row.dim() == 2 else row for row in rows],
                        camera_from_world=leaves[5], camera=splats.camera)  # fmt: skip
        with torch.no_grad():
            rows[0].add_(1.0)
        out.color.sum().backward()
    assert rows[0].shape == (3, count)


def test_two_graphs_do_not_share_state(splats_of):
    first, second = _single(splats_of("random", seed=1)), _single(splats_of("flat", seed=2))
    camera = splats_of("random").camera

    def loss(inputs):
        return rasterize(*inputs[:5], camera_from_world=inputs[5], camera=camera).color.square().sum()

    alone = torch.autograd.grad(loss(first), first)
    graph = loss(first)
    torch.autograd.grad(loss(second), second)
    for _ in range(2):
        together = torch.autograd.grad(graph, first, retain_graph=True)
        assert all(torch.equal(a, b) for a, b in zip(alone, together))


def test_backends_are_named_and_probed(splats_of):
    splats = splats_of("random")
    inputs = _single(splats)
    status = backend_status()
    assert set(status) == set(BACKENDS) and status["cpu"] == "works"

    def call(backend, tensors=inputs):
        return rasterize(*tensors[:5], camera_from_world=tensors[5], camera=splats.camera, backend=backend)

    with pytest.raises(InputError, match="did you mean 'gsplat'"):
        call("gsplatt")
    if status["gsplat"] != "works":
        with pytest.raises(InputError, match="gsplat"):
            call("gsplat")
    with pytest.raises(InputError, match="float32"):
        call("cpu", [*splats.tensors, splats.camera_from_world])
    assert call("auto").color.dtype == torch.float32


@pytest.mark.parametrize(
    "change, words",
    [
        (dict(means=torch.zeros(200, 2)), r"means must have the shape \[N, 3\], got \(200, 2\)"),
        (dict(means=torch.tensor(1.0)), r"means must have the shape"),
        (dict(quaternions=torch.zeros(200, 3)), r"quaternions must have the shape \(200, 4\) for means of \(200, 3\)"),
        (dict(opacity_logits=torch.zeros(200, 1)), r"opacity_logits must have the shape \(200,\)"),
        (dict(colors=torch.zeros(199, 3)), r"colors must have the shape \(200, 3\)"),
        (dict(colors=None), "got neither"),
        (dict(sh=torch.zeros(200, 4, 3)), "got both"),
        (dict(colors=None, sh=torch.zeros(200, 5, 3)), "K is 1, 4, 9 or 16"),
        (dict(channels=torch.zeros(200)), r"channels must have the shape \[200, D\]"),
        (dict(channels=torch.zeros(200, 0)), "D at least 1"),
        (dict(channels=torch.zeros(200, 1, dtype=torch.float64)), "one type on one device"),
        (dict(log_scales=torch.zeros(200, 3, device="meta")), "one type on one device"),
        (dict(camera_from_world=torch.zeros(3, 4)), r"camera_from_world must have the shape \[4, 4\]"),
        (dict(camera_from_world=torch.zeros(0, 4, 4)), "C at least 1"),
        (dict(camera_from_world=np.eye(4)), "must be a torch tensor, got ndarray"),
        (dict(camera=None), "PinholeCamera"),
        (dict(max_alpha=1.0), r"max_alpha must lie in \(0, 1\)"),
        (dict(threads=0), "threads must be at least 1"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_sentence(change, words, splats_of):
    splats = splats_of("random")
    names = ("means", "quaternions", "log_scales", "opacity_logits", "colors", "camera_from_world")
    arguments = dict(zip(names, _single(splats)), camera=splats.camera)
    with pytest.raises(InputError, match=words) as caught:
        rasterize(**(arguments | change))
    assert "\n" not in str(caught.value)


def test_importing_the_package_does_not_load_torch():
    code = (
        "import sys, activestructure_gym.splatting as s; before = 'torch' in sys.modules;"
        "from activestructure_gym.splatting import rasterize; print(before, callable(rasterize), hasattr(s, 'nothing'))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["False", "True", "False"]
