"""MonoGS by hand: its loss, its seeds, its window, what it prunes, and torch's own Adam on the whole window."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.mapping.systems.dense import roundness
from activestructure_gym.mapping.systems.monogs.mapper import (
    MonoGSMapper,
    crowded,
    mean_rate,
    overlap,
    seed_sigmas,
    seen_means,
    window_loss,
)
from activestructure_gym.splatting.reference import rasterize_reference


def _mapper(**changes):
    return MonoGSMapper(dataclasses.replace(MAPPERS.get("monogs"), **changes), np.random.default_rng(0))


def test_the_loss_by_hand():
    """Two pixels: one black without a return, one off by .3 in one of 6 colours and by .4 m in one of 2 depths."""
    shown = SimpleNamespace(
        color=torch.tensor([[[0.9, 0.9, 0.9], [0.5, 0.5, 0.8]]]), depth=torch.tensor([[7.0, 2.4]]), alpha=None
    )
    rgb, depth = torch.tensor([[[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]]), torch.tensor([[0.0, 2.0]])
    loss = window_loss(shown, rgb, depth, 0.95)
    assert float(loss.total) == pytest.approx(0.95 * 0.05 + 0.05 * 0.2)
    assert loss.terms[:2].tolist() == pytest.approx([0.05, 0.2])


def test_roundness_by_hand():
    """Axes of 1, 2, 6 m lie 2, 1, 3 m from their mean, those of a ball 0: the mean over six axes is 1 m."""
    rows = torch.zeros(14, 2)
    rows[7:10, 0] = torch.log(torch.tensor([1.0, 2.0, 6.0]))
    assert float(roundness(rows)) == pytest.approx(1.0)


def test_a_seed_is_as_wide_as_the_root_of_its_spacing():
    """On a line at 0, 1, 2, 4 m the first has neighbours at 1, 2, 4: d^2 = 7. p is .05 m, or .05 of a nearer median."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [4, 0, 0]])
    assert seed_sigmas(points, 3.0, 0.05)[0] == pytest.approx(np.sqrt(7 * 0.05))
    assert seed_sigmas(points, 0.5, 0.05)[0] == pytest.approx(np.sqrt(7 * 0.025))
    assert seed_sigmas(points, 3.0, 0.05)[3] == pytest.approx(np.sqrt((4 + 9 + 16) / 3 * 0.05))


def test_overlap_is_of_what_the_lesser_sees():
    a, b = np.array([1, 1, 1, 1, 0, 0], bool), np.array([0, 0, 0, 1, 1, 0], bool)
    assert overlap(a, b) == overlap(b, a) == 0.5
    assert overlap(a, np.zeros(6, bool)) == 0.0


def test_a_mean_is_seen_where_its_surface_was_measured():
    camera = PinholeCamera.from_size(8, 6)
    frame = Frame(np.zeros((6, 8, 3), np.uint8), np.full((6, 8), 2.0, np.float32), np.eye(4), camera)
    frame.depth[:, :4] = 0.0  # no return on the left
    means = np.array([[0.1, 0, 2.0], [0.1, 0, 2.2], [0.1, 0, 1.8], [-0.1, 0, 2.0], [0.1, 0, -2.0], [9.0, 0, 2.0]])
    assert seen_means(means, frame).tolist() == [True, False, False, False, False, False]


def test_who_is_near_the_others_goes():
    """Newest at 0; those at 1 and 1.1 m crowd; of both the farther goes. The two newest are never named."""
    places = [np.array([x, 0.0, 0.0]) for x in (0.0, 0.01, 1.0, 1.1, 3.0)]
    scores = [1.0**0.5 * (10 + 1 / 2), 1.1**0.5 * (10 + 1 / 1.9), 3.0**0.5 * (1 / 2 + 1 / 1.9)]
    assert crowded(places) == 2 + int(np.argmax(scores)) == 3


def test_the_window_keeps_the_newest_and_what_overlaps(room_frames):
    mapper = _mapper(iterations=1, window=4)
    for frame in room_frames[:6]:
        mapper.observe(frame)
        assert mapper._window[0] == len(mapper.keyframes) - 1
        assert len(mapper._window) <= 4
    back = dataclasses.replace(
        room_frames[0], world_from_camera=look_along(np.array([2.0, 1.5, 1.2]), np.array([0.0, 0.0, 1.0]))
    )
    kept = mapper._window
    mapper.observe(back)  # shares nothing with the others: the oldest of them leaves, and only that
    assert mapper._window == [6, *[k for k in kept if k != kept[-1]]]


def test_a_step_renders_the_window_and_two_others(room_frames):
    mapper = _mapper(iterations=2, window=3, least_overlap=0.0, first_rounds=5)
    reports = [mapper.observe(frame) for frame in room_frames[:6]]
    assert len(reports[0].views) == 5 * 2  # of one keyframe
    window = mapper._window
    assert len(reports[-1].views) == 2 * (len(window) + 2)
    for step in (reports[-1].views[:5], reports[-1].views[5:]):
        assert list(step[:3]) == window
        assert len(set(step[3:])) == 2 and not set(step[3:]) & set(window)


def test_the_rate_falls_from_end_to_end():
    config = MAPPERS.get("monogs")
    assert mean_rate(config, 0) == pytest.approx(9.6e-4)
    assert mean_rate(config, 15_000) == pytest.approx(9.6e-5)
    assert mean_rate(config, 30_000) == mean_rate(config, 60_000) == pytest.approx(9.6e-6)


def test_two_steps_are_torch_s(render_room, room_frames):
    """Loss, sum over the window, roundness and Adam against plain torch in float64."""
    frames = [render_room(frame.world_from_camera, PinholeCamera.from_size(24, 18)) for frame in room_frames[:2]]
    for frame in frames:  # two Gaussians at the same depth may be blended in either order
        frame.depth[:] *= 1.0 + 0.01 * np.random.default_rng(0).standard_normal(frame.depth.shape)
    mapper = _mapper(iterations=0, seed_share=0.5, first_seed_share=0.5)
    for frame in frames:
        mapper.observe(frame)
    # No balls, whose turns change nothing.
    mapper.map.parameters[7:10, : mapper.map.count] += np.random.default_rng(1).normal(0.5, 0.5, (3, mapper.map.count))
    seeds = mapper.map.parameters[:, : mapper.map.count].astype(np.float64)
    mapper._window = [0]
    mapper._event(1, 2)
    parts = [(slice(3, 7), 1e-3), (slice(7, 10), 6e-3), (slice(10, 11), 5e-2), (slice(11, 14), 2.5e-3 * 0.28209479)]
    leaves = [
        torch.tensor(seeds[:3], requires_grad=True),
        *[torch.tensor(seeds[p], requires_grad=True) for p, _ in parts],
    ]
    adam = torch.optim.Adam([{"params": [one]} for one in leaves], eps=1e-15)
    config = MAPPERS.get("monogs")
    for step in (1, 2):
        for group, rate in zip(adam.param_groups, [mean_rate(config, step), *[rate for _, rate in parts]]):
            group["lr"] = rate
        rows = torch.cat(leaves)
        loss = 10.0 * roundness(rows)
        for frame in frames:
            pose = torch.tensor(np.linalg.inv(frame.world_from_camera))
            color, depth, _ = rasterize_reference(
                rows[:3].T, rows[3:7].T, rows[7:10].T, rows[10], rows[11:].T, pose, frame.camera, centre_depth=True
            )
            shown = SimpleNamespace(color=color, depth=depth)
            target = torch.tensor(frame.rgb / 255.0), torch.tensor(frame.depth, dtype=torch.float64)
            loss = loss + window_loss(shown, *target, 0.95).total
        adam.zero_grad()
        loss.backward()
        adam.step()
    expected = torch.cat(leaves).detach().numpy()
    found = mapper.map.parameters[:, : mapper.map.count]
    assert np.abs(found - seeds).max() > 0.05
    for part, rate in [(slice(0, 3), 9.6e-4), *parts]:
        # A derivative of about 0 may have either sign in float32; Adam makes a whole step of it.
        assert np.mean(np.abs(found[part] - expected[part]) > 0.05 * rate) < 0.02


def test_only_old_ones_are_judged(room_frames):
    mapper = _mapper(iterations=4, first_rounds=1, prune_every=8, prune_after=4)
    first = mapper.observe(room_frames[0])
    assert first.pruned > 0  # steps 1 to 4: at the fourth, opacities of about .6 are below .7
    second = mapper.observe(room_frames[1])  # steps 5 to 8: no judgement
    assert second.pruned == 0
    mapper.map.parameters[10, : mapper.map.count] = 3.0
    young = mapper.map.next_id
    mapper.observe(room_frames[2], iterations=2)
    old = mapper.map.ids[: mapper.map.count] < young
    mapper.map.parameters[10, : mapper.map.count] = -3.0
    count = mapper.map.count
    assert mapper._prune_opaque() == np.count_nonzero(old) < count


def test_adam_counts_its_steps_from_where_the_moments_were_forgotten(room_frames, monkeypatch):
    mapper, numbers, step = _mapper(iterations=1, first_rounds=3), [], MonoGSMapper._step

    def noted(self, rows, columns, rates, number):
        numbers.append((number, bool(self.map.first_moment[:, : self.map.count].any())))
        step(self, rows, columns, rates, number)

    monkeypatch.setattr(MonoGSMapper, "_step", noted)
    mapper.observe(room_frames[0])
    mapper.observe(room_frames[1])
    mapper.refine(2)
    mapper.observe(room_frames[2])
    assert numbers == [(1, False), (2, True), (3, True), (4, True), (1, False), (2, True), (1, False)]
