"""A mapping event by another backend is the event of the kernels."""

import dataclasses

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, se3_exp
from activestructure_gym.mapping import MAPPERS, Mapper
from activestructure_gym.mapping.config import MapperConfig
from tests.splatting.gsplat_on_cpu import on_cpu

CAMERA = PinholeCamera.from_size(32, 24)
# Turned about their axis: of rows that lie level, all depths of a floor's row are equal, and rounding sorts them.
ROLL = se3_exp(np.array([0.0, 0.0, 0.0, 0.05, 0.02, 0.3]))


@pytest.fixture(scope="module")
def rolled_frames(render_room, room_frames):
    return [render_room(frame.world_from_camera @ ROLL, CAMERA) for frame in room_frames[:2]]


def observed(frames, iterations, recipe="default", other="reference", **changes):
    maps, reports = [], []
    for backend in ("cpu", other):
        config = MapperConfig(**{**vars(MAPPERS.get(recipe)), "backend": backend, **changes})
        mapper = Mapper(config, np.random.default_rng(0))
        reports.append([mapper.observe(frame, iterations=iterations) for frame in frames])
        maps.append(mapper.map)
    for kernels, reference in zip(*reports):
        for name in ("added", "replaced", "pruned", "count", "new_share", "views"):
            assert getattr(reference, name) == getattr(kernels, name)
        for name in ("color_loss", "depth_loss", "ssim", "psnr"):
            assert getattr(reference, name) == pytest.approx(getattr(kernels, name), rel=1e-4, abs=1e-6, nan_ok=True)
    return maps


@pytest.mark.parametrize("recipe", ["default", "splatam"])
def test_an_event_by_gsplat_prunes_and_steps_alike(recipe, rolled_frames):
    pytest.importorskip("gsplat")
    with on_cpu():
        kernels, gsplat = observed(rolled_frames, 4, recipe, other="gsplat", adam_epsilon=1e-5, prune_steps=(0, 2, -1))
    difference = np.abs(kernels.parameters[:3, : kernels.count] - gsplat.parameters[:3, : kernels.count])
    assert np.quantile(difference, 0.99) <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("recipe", ["default", "splatam"])
def test_ten_iterations_agree(recipe, rolled_frames):
    """Adam divides by the gradient's own size, so where a derivative is 0 rounding alone decides where it goes: a round
    disk may turn about its normal. Hence an epsilon above that noise; and a depth off by millimetres, since where the
    map's is that of the picture the loss |ED - D| has a kink.
    """
    frame, rng = rolled_frames[0], np.random.default_rng(3)
    noise = 5e-3 * rng.standard_normal(frame.depth.shape).astype(np.float32)
    frames = [dataclasses.replace(frame, depth=frame.depth + noise)]
    kernels, reference = observed(frames, 10, recipe, adam_epsilon=1e-5)
    count = kernels.count
    assert np.abs(kernels.parameters[:, :count] - reference.parameters[:, :count]).max() <= 1e-4
    moved = np.abs(kernels.parameters[11:, :count] - observed(frames, 0, recipe)[0].parameters[11:, :count])
    assert np.median(moved) > 10 * 1e-4  # there was something to agree on


@pytest.mark.slow
def test_the_recipe_as_it_is_agrees_in_what_shows(rolled_frames):
    """With Adam's own epsilon and depths that are right: both of the above."""
    kernels, reference = observed(rolled_frames, 5)
    rows = np.r_[0:3, 10:14]
    difference = np.abs(kernels.parameters[rows, : kernels.count] - reference.parameters[rows, : kernels.count])
    assert np.quantile(difference, 0.99) <= 1e-4
    assert np.array_equal(kernels.ids[: kernels.count], reference.ids[: kernels.count])
