"""One protocol, three names: the kernels are the measure, the reference and gsplat's code path agree with them."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.splatting import LossWeights, cpu, ssim_and_gradient
from activestructure_gym.splatting.backends import BACKENDS
from activestructure_gym.splatting.rasterizers import rasterizer
from activestructure_gym.splatting.torch_losses import ssim
from tests.splatting import gsplat_on_cpu

RATES = np.array([2e-4] * 3 + [2e-3] * 4 + [2e-3] * 3 + [0.1] + [5e-3] * 3, np.float32)


def targets_of(camera):
    rng = np.random.default_rng(5)
    depth = rng.uniform(0.5, 4.0, (camera.height, camera.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    return rng.random((camera.height, camera.width, 3), dtype=np.float32), depth


def state_of(splats, spare=8):
    """Parameters and moments as large as a gradient, with columns behind the map that nobody may touch."""
    rng = np.random.default_rng(1)
    parameters = splats.parameters(capacity=len(splats.means) + spare)
    first = (1e-4 * rng.normal(size=parameters.shape)).astype(np.float32)
    second = ((1e-4 * rng.uniform(0.5, 2.0, parameters.shape)) ** 2).astype(np.float32)
    return [parameters, first, second]


def stepped(rasterizer, splats, **options):
    state = state_of(splats)
    camera = splats.camera
    losses = rasterizer.mapping_step(
        *state, len(splats.means), camera, splats.world_from_camera, *targets_of(camera),
        learning_rates=RATES, **options,
    )  # fmt: skip
    return losses, state


def assert_same_step(expected, found, before, count):
    (losses, state), (other, others) = expected, found
    assert (other.color, other.depth) == pytest.approx((losses.color, losses.depth), rel=1e-4)
    assert other.ssim == pytest.approx(losses.ssim, rel=1e-4, nan_ok=True)
    for array, own, start in zip(state, others, before):
        for row in range(14):
            # What the step changed, to a thousandth: alphas at their limits may be decided differently.
            change = np.linalg.norm(array[row] - start[row])
            rounding = np.abs(start[row]).max() * 1.2e-7 * np.sqrt(count)
            assert np.linalg.norm(own[row] - array[row]) <= 1e-3 * change + rounding, row
        assert np.array_equal(own[:, count:], start[:, count:])


@pytest.mark.parametrize(
    "kind, weights, options",
    [
        ("random", LossWeights(image=0.7, l1_share=0.6, depth=0.4, alpha=0.3), {}),
        ("border", LossWeights(image=0.7, l1_share=1.0, depth=0.4, normalised_depth=False), {"epsilon": 1e-6}),
        ("flat", LossWeights(depth=0.4, alpha=0.3), {"beta1": 0.8, "beta2": 0.9}),
        ("behind", LossWeights(alpha=0.1), {"isotropic": True}),
        ("clamped", LossWeights(image=0.0, alpha=0.3), {}),
        ("flat", LossWeights(depth=0.4, centre_depth=True), {}),
    ],
)
def test_a_step_by_the_reference_is_the_kernels(kind, weights, options, splats_of):
    splats = splats_of(kind, seed=2)
    expected = stepped(cpu, splats, weights=weights, **options)
    found = stepped(rasterizer("reference"), splats, weights=weights, **options)
    before = state_of(splats)
    assert_same_step(expected, found, before, len(splats.means))
    # Who has no weight in any pixel keeps parameters and moments, to the bit; both sorts are there.
    same = [(own == start).all(axis=0)[: len(splats.means)] for own, start in zip(found[1], before)]
    assert np.array_equal(same[0], same[1]) and 0 < same[0].sum() < len(splats.means)
    assert np.array_equal(same[1], (expected[1][1] == before[1]).all(axis=0)[: len(splats.means)])


@pytest.mark.parametrize("name", ["cpu", "reference"])
def test_what_is_called_unseen_is_neither_drawn_nor_stepped(name, splats_of):
    splats = splats_of("random")
    one = rasterizer(name)
    camera, pose, count = splats.camera, splats.world_from_camera, len(splats.means)
    assert count <= 1024  # one chunk
    before = state_of(splats)
    losses, state = stepped(one, splats, weights=LossWeights(), unseen=np.ones(1, bool))
    assert all(np.array_equal(own, start) for own, start in zip(state, before))
    assert losses.color == pytest.approx(np.abs(targets_of(camera)[0]).mean(), rel=1e-5)  # against black
    _, state = stepped(one, splats, weights=LossWeights(), unseen=np.zeros(1, bool))
    assert not np.array_equal(state[0], before[0])
    if name == "cpu":
        shown = one.render(before[0], count, camera, pose, unseen=np.ones(1, bool))
        assert not shown.alpha.any() and not shown.color.any()


@pytest.mark.parametrize("kind", ["random", "behind", "empty"])
def test_pictures_by_the_reference_are_the_kernels(kind, splats_of, settled):
    splats = splats_of(kind)
    camera, pose, count = splats.camera, splats.world_from_camera, len(splats.means)
    parameters = splats.parameters(capacity=count + 5)
    parameters[:, count:] = np.nan  # nobody reads what lies beyond
    sure = settled(splats).numpy()
    expected, found = (one.render(parameters, count, camera, pose) for one in (cpu, rasterizer("reference")))
    for name in ("color", "depth", "alpha"):
        own = getattr(found, name)
        assert own.dtype == np.float32 and own.shape == getattr(expected, name).shape
        assert np.abs(own - getattr(expected, name))[sure].max() <= 5e-5
    turn = np.eye(4)
    turn[0, 3] = 0.3
    depth, alpha = rasterizer("reference").render_depth_alpha(parameters, count, camera, np.stack([pose @ turn, pose]))
    assert np.abs(depth[1] - found.depth).max() <= 1e-6 and np.abs(alpha[1] - found.alpha).max() <= 1e-6
    assert kind == "empty" or np.abs(alpha[0] - alpha[1]).max() > 0.1


def test_similarity_is_the_kernels(rng):
    one, other = (rng.random((17, 23, 3), dtype=np.float32) for _ in range(2))
    assert float(ssim(torch.tensor(one), torch.tensor(other))) == pytest.approx(
        ssim_and_gradient(one, other)[0], rel=1e-5
    )


def test_the_way_through_gsplat_gives_the_same(gsplat_device, splats_of, monkeypatch):
    gsplat = rasterizer("gsplat")
    splats = splats_of("random", seed=2)
    camera, pose, count = splats.camera, splats.world_from_camera, len(splats.means)
    for weights in (
        LossWeights(image=0.7, l1_share=0.6, depth=0.4, alpha=0.3), LossWeights(depth=0.4, centre_depth=True),
    ):  # fmt: skip
        assert_same_step(
            stepped(cpu, splats, weights=weights), stepped(gsplat, splats, weights=weights), state_of(splats), count
        )
    parameters = splats.parameters()
    expected = rasterizer("reference").render(parameters, count, camera, pose)
    assert np.quantile(np.abs(gsplat.render(parameters, count, camera, pose).color - expected.color), 0.999) <= 1e-4
    monkeypatch.setattr("activestructure_gym.splatting.torch_rasterizer._AT_ONCE", 2 * count)
    depth, alpha = gsplat.render_depth_alpha(parameters, count, camera, np.stack([pose] * 3))  # in two parts
    assert np.quantile(np.abs(depth - expected.depth), 0.999) <= 1e-4
    assert np.abs(alpha[0] - alpha[2]).max() <= 1e-5
    before = gsplat_on_cpu.CALLS.total()
    empty = gsplat.render(parameters, 0, camera, pose)
    assert not empty.alpha.any() and gsplat_on_cpu.CALLS.total() == before  # an empty map needs no call


def test_names(monkeypatch):
    assert rasterizer("cpu") is cpu
    assert copy.deepcopy(rasterizer("reference")).backend == "reference"
    with pytest.raises(InputError, match="did you mean 'gsplat'"):
        rasterizer("gsplt")
    gsplat = BACKENDS.get("gsplat")
    missing = replace(gsplat, status=lambda: "no CUDA device is visible to torch")
    monkeypatch.setitem(BACKENDS._entries, "gsplat", missing)
    rasterizer.cache_clear()
    with pytest.raises(InputError, match="'gsplat' cannot run here .no CUDA device is visible to torch.; use mapper"):
        rasterizer("gsplat")
    monkeypatch.setitem(BACKENDS._entries, "gsplat", replace(gsplat, status=lambda: "works"))
    assert rasterizer("gsplat").device == "cuda"
    rasterizer.cache_clear()


def test_what_does_not_fit_is_refused(splats_of, monkeypatch):
    splats = splats_of("random")
    uneven = RATES.copy()
    uneven[8] = 0.1
    state, count = state_of(splats), len(splats.means)
    arguments = (count, splats.camera, splats.world_from_camera, *targets_of(splats.camera))
    reference = rasterizer("reference")
    with pytest.raises(ValueError, match="one learning rate"):
        reference.mapping_step(*state, *arguments, weights=LossWeights(), learning_rates=uneven, isotropic=True)
    with pytest.raises(ValueError, match="second_moment must be float32"):
        reference.mapping_step(*state[:2], state[2][:, 1:], *arguments, weights=LossWeights(), learning_rates=RATES)
    with pytest.raises(ValueError, match="count must lie in"):
        reference.render(state[0], 999, *arguments[1:3])
    monkeypatch.setattr("activestructure_gym.splatting.torch_rasterizer._MAX_PAIRS", 1000)
    with pytest.raises(InputError, match="70 x 50 pixels with 200 Gaussians make 700,000; use mapper.backend=cpu"):
        reference.mapping_step(*state, *arguments, weights=LossWeights(), learning_rates=RATES)
