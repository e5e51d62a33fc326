"""One protocol, three names: the kernels are the measure, the reference and gsplat's code path agree with them."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from activestructure_gym.errors import InputError
from activestructure_gym.geometry.frame import Frame, unit_rgb
from activestructure_gym.splatting import LossWeights, cpu, ssim_and_gradient
from activestructure_gym.splatting.backends import BACKENDS
from activestructure_gym.splatting.rasterizers import rasterizer
from activestructure_gym.splatting.torch_losses import ssim
from activestructure_gym.splatting.torch_rasterizer import TorchRasterizer
from tests.splatting import gsplat_on_cpu

RATES = np.array([2e-4] * 3 + [2e-3] * 4 + [2e-3] * 3 + [0.1] + [5e-3] * 3, np.float32)


def frame_of(splats):
    camera, rng = splats.camera, np.random.default_rng(5)
    depth = rng.uniform(0.5, 4.0, (camera.height, camera.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    rgb = rng.integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
    return Frame(rgb, depth, splats.world_from_camera, camera)


def state_of(splats, spare=8):
    """Parameters and moments as large as a gradient, with columns behind the map that nobody may touch."""
    rng = np.random.default_rng(1)
    parameters = splats.parameters(capacity=len(splats.means) + spare)
    first = (1e-4 * rng.normal(size=parameters.shape)).astype(np.float32)
    second = ((1e-4 * rng.uniform(0.5, 2.0, parameters.shape)) ** 2).astype(np.float32)
    return [parameters, first, second]


def stepped(rasterizer, splats, *, weights, steps=1, beta1=0.9, beta2=0.999, isotropic=False, **options):
    """Losses [steps, 3] and the state after an event of some steps on one frame."""
    state, frame = state_of(splats), frame_of(splats)
    event = rasterizer.begin(*state, len(splats.means), weights=weights, beta1=beta1, beta2=beta2, isotropic=isotropic)
    for _ in range(steps):
        event.step(frame, learning_rates=RATES, **options)
    return event.end(), state


def assert_same_step(expected, found, before, count):
    (losses, state), (other, others) = expected, found
    assert other.dtype == np.float64 and other == pytest.approx(losses, rel=1e-4, nan_ok=True)
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
    assert losses[0, 0] == pytest.approx(unit_rgb(frame_of(splats)).mean(), rel=1e-5)  # against black
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
    (red,) = rasterizer("reference").render_values(parameters, count, camera, pose[None], parameters[11, :count])
    assert np.array_equal(red, found.color[..., 0])


def test_similarity_is_the_kernels(rng):
    one, other = (rng.random((17, 23, 3), dtype=np.float32) for _ in range(2))
    assert float(ssim(torch.tensor(one), torch.tensor(other))) == pytest.approx(
        ssim_and_gradient(one, other)[0], rel=1e-5
    )


def test_the_way_through_gsplat_gives_the_same(gsplat_device, splats_of, monkeypatch):
    gsplat = rasterizer("gsplat")
    splats = splats_of("random", seed=2)
    camera, pose, count = splats.camera, splats.world_from_camera, len(splats.means)
    for options in (
        {"weights": LossWeights(image=0.7, l1_share=0.6, depth=0.4, alpha=0.3), "steps": 3},
        {"weights": LossWeights(depth=0.4, centre_depth=True), "beta1": 0.8, "beta2": 0.9, "epsilon": 1e-6},
        {"weights": LossWeights(alpha=0.1, normalised_depth=False), "isotropic": True},
    ):
        expected, found = (stepped(one, splats, **options) for one in (cpu, gsplat))
        assert_same_step(expected, found, state_of(splats), count)
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


def test_gsplat_steps_only_the_chunks_that_may_be_seen(gsplat_device, splats_of):
    splats = splats_of("crowd")
    count, before, unseen = len(splats.means), state_of(splats), np.array([True, False])
    assert 1024 < count <= 2048
    expected, found = (
        stepped(one, splats, weights=LossWeights(), unseen=unseen) for one in (cpu, rasterizer("gsplat"))
    )
    assert_same_step(expected, found, before, count)
    changed = (found[1][0] != before[0]).any(axis=0)
    assert not changed[:1024].any() and changed[1024:count].any()


def test_a_step_of_gsplat_copies_nothing_and_waits_for_nothing(gsplat_device, splats_of, monkeypatch):
    splats = splats_of("random")
    state, frame = state_of(splats), frame_of(splats)
    before, gsplat = [array.copy() for array in state], rasterizer("gsplat")
    copied, tensor = [], TorchRasterizer.tensor
    monkeypatch.setattr(TorchRasterizer, "tensor", lambda own, array: copied.append(array.shape) or tensor(own, array))
    event = gsplat.begin(*state, len(splats.means), weights=LossWeights(alpha=0.3))
    assert copied == [(3, 14, len(splats.means))]
    event.step(frame, learning_rates=RATES)
    assert len(copied) == 4  # pose, colours and depth
    waits = Waits()
    with waits:
        event.step(frame, learning_rates=RATES)
    assert len(copied) == 4 and waits.found == [] and waits.operations > 100
    assert all(np.array_equal(array, start) for array, start in zip(state, before))
    assert event.end().shape == (2, 3) and not np.array_equal(state[0], before[0])
    assert gsplat.begin(*state, len(splats.means), weights=LossWeights()).end().shape == (0, 3)


class Waits(TorchDispatchMode):
    """Torch operations that read a number or a shape back from the device."""

    def __init__(self):
        super().__init__()
        self.found, self.operations = [], 0

    def __torch_dispatch__(self, operation, types, arguments=(), options=None):
        # A stand-in may read what it likes.
        if not gsplat_on_cpu.RUNNING:
            name = operation.overloadpacket.__name__
            by_mask = name.startswith("index") and any(
                getattr(key, "dtype", None) == torch.bool for key in arguments[1]
            )
            self.operations += 1
            self.found += [name] if name in ("_local_scalar_dense", "nonzero") or by_mask else []
        return operation(*arguments, **(options or {}))


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
    state, count, frame = state_of(splats), len(splats.means), frame_of(splats)
    reference, weights = rasterizer("reference"), LossWeights()
    for one in (reference, cpu):
        event = one.begin(*state, count, weights=weights, isotropic=True)
        with pytest.raises(ValueError, match="one learning rate"):
            event.step(frame, learning_rates=uneven)
    with pytest.raises(ValueError, match="second_moment must be float32"):
        reference.begin(*state[:2], state[2][:, 1:], count, weights=weights)
    with pytest.raises(ValueError, match="count must lie in"):
        reference.render(state[0], 999, frame.camera, frame.world_from_camera)
    monkeypatch.setattr("activestructure_gym.splatting.torch_rasterizer._MAX_PAIRS", 1000)
    with pytest.raises(InputError, match="70 x 50 pixels with 200 Gaussians make 700,000; use mapper.backend=cpu"):
        reference.begin(*state, count, weights=weights).step(frame, learning_rates=RATES)
