import math

import numpy as np
import pytest
import torch
from scipy.special import lpmv

from activestructure_gym.splatting import rasterize
from activestructure_gym.splatting.reference import camera_centre
from activestructure_gym.splatting.spherical_harmonics import TERMS, evaluate_sh, shade
from activestructure_gym.splatting.workspace import make_grid, make_view


def _directions(count, seed=0):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_basis_is_that_of_scipy():
    """Y_lm = sqrt 2 Re or Im of the complex harmonic (with the Condon-Shortley sign), m = -l ... l."""
    x, y, z = (directions := _directions(50)).T
    azimuth = np.arctan2(y, x)
    expected = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            m = abs(order)
            norm = math.sqrt((2 * degree + 1) / (4 * math.pi) * math.factorial(degree - m) / math.factorial(degree + m))
            value = norm * lpmv(m, degree, z) * (1 if m == 0 else math.sqrt(2))
            expected.append(value * (np.sin(m * azimuth) if order < 0 else np.cos(m * azimuth)))
    for term, values in enumerate(expected):
        coefficients = np.zeros((50, 16, 3))
        coefficients[:, term] = [1.0, -1.0, 0.5]
        wanted = np.maximum(0.5 + values[:, None] * np.array([1.0, -1.0, 0.5]), 0.0)
        assert np.allclose(evaluate_sh(coefficients, 3.7 * directions), wanted, atol=1e-12)


def test_degree_0_knows_no_direction_and_length_0_does_no_harm():
    coefficients = torch.rand(4, 16, 3, dtype=torch.float64, requires_grad=True)
    directions = torch.zeros(4, 3, dtype=torch.float64, requires_grad=True)
    color = evaluate_sh(coefficients, directions)
    assert torch.allclose(color, 0.5 + 0.28209479177387814 * coefficients[:, 0])
    gradients = torch.autograd.grad(color.sum(), (coefficients, directions))
    assert all(torch.isfinite(gradient).all() for gradient in (color, *gradients))
    alone = evaluate_sh(coefficients[:, :1], directions)
    assert torch.allclose(alone, 0.5 + 0.28209479177387814 * coefficients[:, 0])


def _with_harmonics(splats, terms, seed=5):
    """Coefficients in which about every tenth channel of a colour is cut off at 0."""
    generator = torch.Generator().manual_seed(seed)
    sh = torch.randn(len(splats.means), terms, 3, generator=generator) * (1.0 if terms < 9 else 0.3)
    sh[:, 0] += 0.3
    return sh.double().requires_grad_()


@pytest.mark.parametrize("kind", ("random", "behind", "border", "large", "needle", "flat", "pixel"))
def test_cpu_agrees_with_the_reference(kind, splats_of, settled):
    """Blurred as by 3D Gaussian splatting, so that rounding in needles does not hide what harmonics do."""
    splats, blur = splats_of(kind, seed=2), {"blur_variance": 0.3}
    sh, sure = _with_harmonics(splats, 16), settled(splats, **blur)
    by_color = torch.randn(*sure.shape, 3, generator=torch.Generator().manual_seed(0)) * sure[..., None]
    results = []
    for backend in ("reference", "cpu"):
        leaves = [*splats.tensors[:4], sh, splats.camera_from_world]
        if backend == "cpu":
            leaves = [leaf.detach().float().requires_grad_() for leaf in leaves]
        *tensors, own_sh, pose = leaves
        color = rasterize(
            *tensors, sh=own_sh, camera_from_world=pose, camera=splats.camera, backend=backend, **blur
        ).color
        results.append((color, torch.autograd.grad((color * by_color).sum(), leaves)))
    (exact, expected), (color, found) = results
    assert (exact - color)[sure].abs().max() <= 1e-5 * exact.abs().max().clamp_min(1.0)
    for name, a, b in zip(("mean", "quaternion", "log-scale", "opacity", "sh", "pose"), expected, found):
        assert a.norm() > 1e-6, name
        assert (a - b).norm() <= 1e-4 * a.norm(), name


@pytest.mark.parametrize("terms", TERMS)
def test_every_degree_is_the_picture_of_its_colors(terms, splats_of):
    splats = splats_of("random", seed=3)
    sh, centre = _with_harmonics(splats, terms), camera_centre(splats.camera_from_world)
    assert torch.allclose(splats.camera_from_world[:3, :3] @ centre, -splats.camera_from_world[:3, 3])
    colors = evaluate_sh(sh, splats.means - centre)
    share_cut = (colors == 0).double().mean()
    assert 0.003 < share_cut < 0.4
    tensors = [tensor.detach().float() for tensor in splats.tensors[:4]]
    arguments = dict(camera_from_world=splats.camera_from_world.detach().float(), camera=splats.camera)
    own_sh = sh.detach().float().requires_grad_()
    direct = rasterize(*tensors, colors.detach().float(), **arguments)
    by_sh = rasterize(*tensors, sh=own_sh, **arguments)
    assert (direct.color - by_sh.color).abs().max() < 2e-6
    assert torch.equal(direct.depth, by_sh.depth)
    (gradient,) = torch.autograd.grad(by_sh.color.sum(), own_sh)
    share = evaluate_sh(own_sh, (splats.means - centre).detach().float())
    (cut,) = torch.autograd.grad(share.sum(), own_sh)
    assert gradient.shape == own_sh.shape and gradient.abs().sum() > 0
    assert (gradient[cut == 0] == 0).all()


def test_only_what_may_be_seen_is_worked_out(splats_of):
    splats = splats_of("border", seed=1)
    count, pose = len(splats.means), splats.camera_from_world.detach().numpy()
    parameters, sh = splats.parameters(208), _with_harmonics(splats, 16).detach().float().numpy() + 1.0
    away = np.diag([-1.0, 1.0, -1.0, 1.0]) @ pose
    for turned, lit in ((pose, True), (away, False)):
        view, grid = make_view(splats.camera, turned), make_grid(count, 208, splats.camera)
        shade(parameters, sh, turned, view, grid, 1)
        assert (parameters[11:, :count] > 0).any() == lit
