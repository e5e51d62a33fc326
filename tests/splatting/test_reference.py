import math

import numpy as np
import pytest
import torch

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import rasterize
from activestructure_gym.splatting.reference import rasterize_reference, rotation_matrices


def _single(logit=0.0, depth=2.0):
    tensors = (
        torch.tensor([[0.0, 0.0, depth]], dtype=torch.float64),
        torch.tensor([[2.0, 0.0, 0.0, 0.0]], dtype=torch.float64),
        torch.full((1, 3), math.log(0.1), dtype=torch.float64),
        torch.tensor([logit], dtype=torch.float64),
        torch.tensor([[1.0, 0.5, 0.25]], dtype=torch.float64),
    )
    return tensors, torch.eye(4, dtype=torch.float64)


def test_one_gaussian_by_hand():
    # f = 20 px, z = 2 m, sigma = 0.1 m -> 1 px; with a blur of 0.3 px^2 the variance is 1.3 px^2.
    # Centre pixel (10, 10) has its centre at (10.5, 10.5) = the principal point: alpha = sigmoid(0) = 0.5.
    tensors, pose = _single()
    camera = PinholeCamera(21, 21, 20.0, 20.0, 10.5, 10.5)
    color, depth, alpha = rasterize_reference(*tensors, pose, camera, blur_variance=0.3)
    assert alpha[10, 10].item() == pytest.approx(0.5, abs=1e-12)
    assert alpha[10, 12].item() == pytest.approx(0.5 * math.exp(-0.5 * 4 / 1.3), abs=1e-12)
    assert color[10, 10].tolist() == pytest.approx([0.5, 0.25, 0.125], abs=1e-12)
    assert depth[10, 10].item() == pytest.approx(1.0, abs=1e-12)  # 0.5 * 2 m
    # 0.5 exp(-r^2 / 2.6) falls below 1/255 at r = 3.55 px.
    assert alpha[10, 13] > 0 and alpha[10, 14] == 0


@pytest.mark.parametrize("dtype", (torch.float32, torch.float64))  # the kernels, the reference
def test_depth_of_a_slanted_disk_by_hand(dtype):
    # A disk of sigma 0.2 m at 2 m, turned by 45 degrees about y, f = 20 px: its axis is sqrt(2) px long, sqrt(0.02) m
    # deep, so that z falls by 0.2 / (2 + 0.03) m per pixel to the right; that of its plane by 0.2 / 2.
    half = math.radians(45.0) / 2
    tensors = [
        torch.tensor(values, dtype=dtype, requires_grad=True)
        for values in (
            [[0.0, 0.0, 2.0]], [[math.cos(half), 0.0, math.sin(half), 0.0]], [[math.log(0.2), math.log(0.2), -9.0]],
            [2.0], [[1.0, 1.0, 1.0]],
        )
    ]  # fmt: skip
    camera, pose = PinholeCamera(21, 21, 20.0, 20.0, 10.5, 10.5), torch.eye(4, dtype=dtype)
    seen = rasterize(*tensors, camera_from_world=pose, camera=camera)
    for column in (8, 10, 11, 12):
        expected = 2.0 - (column - 10) * 0.2 / 2.03
        assert seen.expected_depth[10, column].item() == pytest.approx(expected, abs=1e-5)
    of_centre = rasterize(*tensors, camera_from_world=pose, camera=camera, centre_depth=True).expected_depth
    assert of_centre[10, 8].item() == of_centre[10, 12].item() == pytest.approx(2.0, abs=1e-6)
    # Moved to the right it is farther in every pixel; turned on, its right side comes nearer.
    by_mean, by_turn = torch.autograd.grad(seen.expected_depth[10, 12], tensors[:2])
    assert by_mean[0, 0] > 0.9 and by_turn[0, 2] < 0 < by_turn[0, 0]


@pytest.mark.parametrize("dtype", (torch.float32, torch.float64))
def test_no_depth_lies_before_the_near_plane(dtype):
    # A needle of 1 m almost along the ray: at some pixels the first order would put it behind the camera.
    half = math.radians(86.0) / 2
    tensors = [
        torch.tensor(values, dtype=dtype, requires_grad=True)
        for values in (
            [[0.0, 0.0, 1.0]], [[math.cos(half), 0.0, math.sin(half), 0.0]], [[0.0, -6.0, -6.0]], [3.0],
            [[1.0, 1.0, 1.0]],
        )
    ]  # fmt: skip
    camera, pose = PinholeCamera(21, 21, 20.0, 20.0, 10.5, 10.5), torch.eye(4, dtype=dtype)
    seen = rasterize(*tensors, camera_from_world=pose, camera=camera, median_depth=True)
    depth = torch.where(seen.alpha > 0, seen.expected_depth, 1.0)
    assert depth.min().item() == pytest.approx(0.01, rel=1e-3) and seen.median_depth.min() >= 0
    at = torch.nonzero(depth == depth.min())[0].tolist()
    (by_mean,) = torch.autograd.grad(seen.expected_depth[at[0], at[1]], tensors[:1])
    assert by_mean.abs().max() < 1e-4


def test_pixel_stops_before_the_gaussian_that_would_empty_it():
    # alpha 0.999 each: after one T = 1e-3; the second would take it to 1e-6 <= 1e-4, so it is left out.
    tensors, pose = _single(logit=50.0)
    tensors = [torch.cat([tensor, tensor]) for tensor in tensors]
    tensors[0][1, 2] = 3.0
    _, depth, alpha = rasterize_reference(*tensors, pose, PinholeCamera(1, 1, 20.0, 20.0, 0.5, 0.5))
    assert alpha.item() == pytest.approx(0.999, abs=1e-12)
    assert depth.item() == pytest.approx(0.999 * 2.0, abs=1e-12)


def test_rotation_agrees_with_scipy():
    from scipy.spatial.transform import Rotation

    rotation = Rotation.random(5, random_state=np.random.default_rng(0))
    quaternions = torch.tensor(rotation.as_quat(scalar_first=True)) * 1.7
    assert np.allclose(rotation_matrices(quaternions).numpy(), rotation.as_matrix(), atol=1e-14)


def test_gradients_against_finite_differences(splats_of):
    splats = splats_of("random", seed=3)
    keep = torch.argsort(splats.means.detach().norm(dim=1))[:6]
    tensors = [tensor.detach()[keep] for tensor in splats.tensors] + [splats.camera_from_world.detach()]
    camera = PinholeCamera(12, 9, 8.0, 8.0, 6.0, 4.5)
    generator = torch.Generator().manual_seed(0)
    weights = [torch.rand(9, 12, c, generator=generator, dtype=torch.float64) for c in (3, 1, 1)]

    def loss(*inputs):
        color, depth, alpha = rasterize_reference(*inputs, camera)
        return (color * weights[0]).sum() + (depth * weights[1][..., 0]).sum() + (alpha * weights[2][..., 0]).sum()

    inputs = [tensor.clone().requires_grad_() for tensor in tensors]
    gradients = torch.autograd.grad(loss(*inputs), inputs)
    step = 1e-7  # small: at 1e-5 the jumps of the 1/255 cut show
    for index, gradient in enumerate(gradients):
        numeric = torch.zeros_like(gradient)
        for position in range(gradient.numel()):
            values = []
            for sign in (1, -1):
                moved = [tensor.clone() for tensor in tensors]
                moved[index].view(-1)[position] += sign * step
                values.append(loss(*moved))
            numeric.view(-1)[position] = (values[0] - values[1]) / (2 * step)
        if index == 5:
            gradient, numeric = gradient[:3], numeric[:3]
        assert torch.linalg.vector_norm(gradient - numeric) <= 1e-6 * torch.linalg.vector_norm(numeric)
        assert torch.linalg.vector_norm(numeric) > 1e-4
