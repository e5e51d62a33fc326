import pytest
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.splatting.api import rasterize
from activestructure_gym.splatting.backends import BACKENDS, backend_status

KINDS = ("random", "behind", "border", "clamped", "crowd", "needle", "flat", "large", "pixel")


def _single(splats):
    return [tensor.detach().float().requires_grad_() for tensor in (*splats.tensors, splats.camera_from_world)]


@pytest.mark.parametrize("kind", KINDS)
def test_cpu_gradients_agree_with_the_reference(kind, splats_of, settled):
    splats = splats_of(kind, seed=1)
    sure = settled(splats)
    assert sure.double().mean() > 0.8
    generator = torch.Generator().manual_seed(0)
    height, width = sure.shape
    by_color = torch.randn(height, width, 3, generator=generator) * sure[..., None]
    by_depth, by_alpha = (torch.randn(height, width, generator=generator) * sure for _ in range(2))

    def gradients(inputs, backend):
        *tensors, pose = inputs
        out = rasterize(*tensors, camera_from_world=pose, camera=splats.camera, backend=backend)
        loss = (out.color * by_color).sum() + (out.depth * by_depth).sum() + (out.alpha * by_alpha).sum()
        return torch.autograd.grad(loss, inputs)

    expected = gradients([*splats.tensors, splats.camera_from_world], "reference")
    found = gradients(_single(splats), "cpu")
    for name, a, b in zip(("mean", "quaternion", "log-scale", "opacity", "color", "pose"), expected, found):
        assert a.norm() > 1e-6, name
        assert (a - b).norm() <= 1e-4 * a.norm(), name


def test_batch_of_cameras_and_other_limit_of_alpha(splats_of):
    splats = splats_of("clamped")
    *tensors, pose = _single(splats)
    other = pose.detach().clone()
    other[0, 3] += 0.2
    poses = torch.stack([pose.detach(), other])
    both = rasterize(*tensors, camera_from_world=poses, camera=splats.camera, max_alpha=0.9)
    assert both.color.shape == (2, 50, 70, 3) and both.depth.shape == both.alpha.shape == (2, 50, 70)
    one = rasterize(*tensors, camera_from_world=other, camera=splats.camera, max_alpha=0.9)
    assert torch.equal(both.color[1], one.color)
    exact = rasterize(
        *splats.tensors, camera_from_world=poses.double(), camera=splats.camera, backend="reference", max_alpha=0.9
    )
    assert (both.alpha - exact.alpha).abs().mean() < 1e-5
    assert torch.allclose(one.expected_depth, one.depth / one.alpha.clamp_min(1e-10))


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
