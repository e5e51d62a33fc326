"""Gaussian-SLAM by hand: when a sub-map begins, that the others stay, what its seeds and its loss are."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from activestructure_gym.geometry import look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.mapping.systems.dense import adam_step, spacing_squared
from activestructure_gym.mapping.systems.gaussian_slam.mapper import (
    GaussianSLAMMapper,
    exceeds,
    gradient_size,
    submap_loss,
    view_shares,
)
from activestructure_gym.splatting.torch_losses import ssim


def _mapper(**changes):
    return GaussianSLAMMapper(dataclasses.replace(MAPPERS.get("gaussian_slam"), **changes), np.random.default_rng(0))


def _turned(axis, degrees):
    pose, angle = np.eye(4), np.radians(degrees)
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    pose[a, a] = pose[b, b] = np.cos(angle)
    pose[b, a], pose[a, b] = np.sin(angle), -np.sin(angle)
    return pose


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_submap_ends_after_half_a_metre_or_fifty_degrees(axis):
    limits = {"metres": 0.5, "degrees": 50.0}
    origin = look_along(np.array([1.0, 2.0, 3.0]), np.array([0.3, -0.4, 0.2]))
    assert not exceeds(origin, origin @ _turned(axis, 49.0), **limits)
    assert exceeds(origin, origin @ _turned(axis, 51.0), **limits)
    moved = np.eye(4)
    moved[axis, 3] = 0.49
    assert not exceeds(origin, origin @ moved, **limits)
    moved[axis, 3] = -0.51
    assert exceeds(origin, origin @ moved, **limits)


def test_four_of_ten_steps_are_of_the_current_keyframe():
    assert view_shares(1, 0.4).tolist() == [1.0]
    assert view_shares(4, 0.4) == pytest.approx([0.4, 0.2, 0.2, 0.2])


def test_the_loss_by_hand():
    """Half the pixels have no return: the absolute differences do not see them, SSIM does."""
    rng = torch.Generator().manual_seed(0)
    color, rgb = (torch.rand((12, 14, 3), generator=rng, dtype=torch.float64) for _ in range(2))
    depth = torch.full((12, 14), 2.0, dtype=torch.float64)
    depth[:, 7:] = 0.0
    shown = SimpleNamespace(color=color, depth=torch.full_like(depth, 2.25))
    loss = submap_loss(shown, rgb, depth, image=1.0, l1_share=0.8, depth_weight=1.0)
    expected = 0.8 * (color - rgb)[:, :7].abs().mean() + 0.2 * (1.0 - ssim(color, rgb)) + 0.25
    assert float(loss.total) == pytest.approx(float(expected))


def test_frozen_submaps_keep_every_bit(room_frames):
    """Twelve keyframes all around: each turn of more than 50 degrees begins another sub-map."""
    mapper = _mapper(iterations=2)
    began = []
    for index, frame in enumerate(room_frames[:6]):
        start, before = mapper._start, mapper.map.parameters[:, : mapper.map.count].copy()
        mapper.observe(frame)
        if mapper._start != start or not index:
            began.append(index)
            assert mapper._start == before.shape[1]
            start = mapper._start
        assert np.array_equal(mapper.map.parameters[:, :start], before[:, :start])
        assert not np.array_equal(mapper.map.parameters[:, start : mapper.map.count], before[:, start:])
        assert mapper.submap_keyframes == list(range(began[-1], index + 1))
    # Frames stand 30 degrees and .31 m apart on a circle of .6 m and look up and down in turn.
    assert began[0] == 0 and 1 < len(began) < 6


def test_a_submap_knows_nothing_of_the_others(room_frames):
    """The first keyframe seen again after a while: its surface is mapped, and all of it counts as missing."""
    mapper = _mapper(iterations=0)
    for frame in (room_frames[0], room_frames[6], room_frames[0]):
        report = mapper.observe(frame)
        assert report.new_share == pytest.approx(np.mean(frame.depth > 0))
        assert report.added > 0.2 * frame.depth.size


def test_seeds_stand_a_little_behind(room_frames):
    frame = dataclasses.replace(room_frames[0], world_from_camera=np.eye(4))
    mapper = _mapper(iterations=0, submap_seed_share=1.0)
    mapper.observe(frame)
    assert mapper.map.count == frame.depth.size
    assert mapper.map.means[:, 2] == pytest.approx(1.005 * frame.depth.ravel(), rel=1e-5)
    assert mapper.map.opacities == pytest.approx(0.5)


def test_sizes_are_the_spacing_of_all_points():
    points = np.array([[0.0, 0, 0], [1, 0, 0]])
    around = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    assert spacing_squared(points, around) == pytest.approx([(1 + 4 + 9) / 3, (1 + 5 + 10) / 3])
    assert spacing_squared(points, points) == pytest.approx([1.0, 1.0])  # of the one there is


def test_no_seed_where_a_gaussian_stands(room_frames):
    mapper = _mapper(iterations=0, submap_seed_share=1.0)
    mapper.observe(room_frames[0])
    assert mapper.observe(room_frames[0]).added == 0  # transparent by its opacities of a half, but the places are taken


def test_pixels_by_gradient_lie_at_an_edge():
    rgb = np.zeros((8, 16, 3), np.uint8)
    rgb[:, 8:] = 200
    size = gradient_size(rgb)
    assert (size[:, 7:9] > 0).all() and (np.delete(size, [7, 8], axis=1) == 0).all()
    frame = Frame(rgb, np.ones((8, 16), np.float32), np.eye(4), _camera(16, 8))
    mapper = _mapper(iterations=0, submap_seed_share=0.01, submap_edge_share=0.5)
    rows, columns = mapper._first_pixels(frame)
    assert len(rows) > 8 and np.count_nonzero((columns != 7) & (columns != 8)) <= 1


def _camera(width, height):
    from activestructure_gym.geometry import PinholeCamera

    return PinholeCamera.from_size(width, height)


def test_colours_wait_for_the_second_half(room_frames):
    mapper = _mapper(iterations=0, prune_opacity=0.0)
    mapper.observe(room_frames[0])
    seeds = mapper.map.parameters[:, : mapper.map.count].copy()
    steps = []
    step = mapper._step
    mapper._step = lambda *args: step(*args) or steps.append(mapper.map.parameters[:, : mapper.map.count].copy())
    mapper.submap_keyframes = [0]
    mapper._event(0, 6)
    colours = [np.abs(after[11:] - seeds[11:]).max() for after in steps]
    assert colours[:3] == [0.0] * 3
    # The first of their own steps is a whole one, as torch's new parameters take it: the rate, whatever the derivative.
    moved = np.abs(steps[3][11:] - seeds[11:])
    assert moved.max() == pytest.approx(2.5e-3 * 0.28209479, rel=1e-2)


def test_adam_is_torch_s():
    rng = np.random.default_rng(0)
    start, gradients = rng.normal(size=(14, 5)).astype(np.float32), rng.normal(size=(4, 14, 5)).astype(np.float32)
    rates = np.linspace(1e-3, 1e-2, 14).astype(np.float32)
    parameters = [torch.tensor(row.copy(), requires_grad=True) for row in start]
    adam = torch.optim.Adam([{"params": [p], "lr": float(r)} for p, r in zip(parameters, rates)], eps=1e-15)
    found, first, second = start.copy(), np.zeros_like(start), np.zeros_like(start)
    for number, gradient in enumerate(gradients, start=1):
        for p, row in zip(parameters, gradient):
            p.grad = torch.tensor(row)
        adam.step()
        adam_step(
            found, first, second, gradient, rates=rates, number=number, betas=(0.9, 0.999), epsilon=1e-15
        )  # fmt: skip
    assert found == pytest.approx(np.stack([p.detach().numpy() for p in parameters]), abs=1e-6)
