"""The recipe ``splatam``: seeding by hand, one event against SplaTAM's loop in plain torch, schedule and bound."""

import dataclasses

import numpy as np
import pytest
import torch
from torch.nn.functional import conv2d

from activestructure_gym.geometry import PinholeCamera, invert_rigid
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import MAPPERS, Mapper
from activestructure_gym.mapping.seeding import missing_pixels, pixel_samples, seed_balls
from activestructure_gym.splatting import cpu
from activestructure_gym.splatting.reference import rasterize_reference


def _mapper(seed=0, **changes):
    return Mapper(dataclasses.replace(MAPPERS.get("splatam"), **changes), np.random.default_rng(seed))


def _frame(depth=2.0):
    depth = np.broadcast_to(np.asarray(depth, np.float32), (6, 8)).copy()
    rgb = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3)
    return Frame(rgb, depth, np.eye(4), PinholeCamera.from_size(8, 6))  # f = 4, centre (4, 3)


def test_a_ball_by_hand():
    """Pixel (row 2, column 6) looks along (.625, -.125, 1)."""
    frame = _frame()
    block = seed_balls(frame, pixel_samples(frame, np.array([2]), np.array([6])), np.array([0.5]))
    assert block[:3, 0] == pytest.approx([1.25, -0.25, 2.0])
    assert block[3:7, 0].tolist() == [1, 0, 0, 0]
    assert np.exp(block[7:10, 0]) == pytest.approx([0.5] * 3)
    assert block[10, 0] == 0.0  # opacity one half
    assert block[11:, 0] * 255 == pytest.approx(3 * (2 * 8 + 6) + np.arange(3))


@pytest.mark.parametrize(("columns", "stride"), [(600, 1), (8, 1), (4, 2)])
def test_a_ball_is_as_large_as_its_pixels(columns, stride):
    """One of the 8 pixels is 2 m / 4 = 0.5 m wide, two are 1 m."""
    mapper = _mapper(iterations=0, seed_columns=columns)
    mapper.observe(_frame())
    assert np.exp(mapper.map.parameters[7:10, : mapper.map.count]) == pytest.approx(0.5 * stride)


def test_seeds_are_the_grid_row_by_row():
    frame = _frame()
    mapper = _mapper(iterations=0, seed_columns=4)
    assert mapper.observe(frame).added == 12
    order = np.lexsort((mapper.map.means[:, 0], mapper.map.means[:, 1]))  # by row, then by column
    assert order.tolist() == list(range(12))
    assert np.exp(mapper.map.parameters[7:10, :12]) == pytest.approx(1.0)
    assert _mapper(iterations=0).observe(frame).added == 48


def test_missing_is_what_is_transparent_or_far_behind():
    """Median of the errors over all 8 pixels, 0 without a return: (0, 0, .01, .01, .01, .01, .6, 2) -> .01."""
    depth = np.array([[2, 2, 2, 2, 2, 2, 2, 0.0]])
    shown = np.array([[2.01, 1.99, 2.01, 2.01, 2.6, 0.0, 2.0, 9.0]])
    alpha = np.array([[1, 1, 1, 0.49, 1, 0.5, 0.5, 1.0]])
    missing = missing_pixels(depth, shown, alpha, error_floor=0.0, normalised=False)
    # transparent: the fourth; behind by more than .5 m: the fifth; the sixth is in front, at half the opacity
    assert np.flatnonzero(missing[0]).tolist() == [3, 4]


def _ssim(image, target):
    taps = torch.exp(-0.5 * ((torch.arange(11, dtype=torch.float64) - 5) / 1.5) ** 2)
    window = torch.outer(taps, taps) / taps.sum() ** 2

    def blur(x):
        return conv2d(x.permute(2, 0, 1)[:, None], window[None, None], padding=5)

    mx, my = blur(image), blur(target)
    xx, yy, xy = blur(image**2) - mx**2, blur(target**2) - my**2, blur(image * target) - mx * my
    return ((2 * mx * my + 1e-4) * (2 * xy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (xx + yy + 9e-4))).mean()


def _event_in_torch(seeds, frame, iterations):
    """SplaTAM's mapping of one frame: a fresh Adam, one shared log-scale, depth as accumulated."""
    mean, quaternion, scale, logit, color = (
        torch.tensor(rows, dtype=torch.float64, requires_grad=True)
        for rows in (seeds[:3].T, seeds[3:7].T, seeds[7:8].T, seeds[10], seeds[11:].T)
    )
    groups = [(mean, 1e-4), (quaternion, 1e-3), (scale, 1e-3), (logit, 5e-2), (color, 2.5e-3)]
    adam = torch.optim.Adam([{"params": [p], "lr": rate} for p, rate in groups], eps=1e-15)
    target, depth = torch.tensor(frame.rgb / 255.0), torch.tensor(frame.depth, dtype=torch.float64)
    pose = torch.tensor(invert_rigid(frame.world_from_camera))
    for _ in range(iterations):
        shown, shown_depth, _ = rasterize_reference(
            mean, quaternion, scale.expand(-1, 3), logit, color, pose, frame.camera, centre_depth=True
        )
        image_loss = 0.8 * (shown - target).abs().mean() + 0.2 * (1 - _ssim(shown, target))
        loss = 0.5 * image_loss + (shown_depth - depth)[depth > 0].abs().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    return [p.detach().numpy() for p in (mean, scale, logit, color)]


def test_one_event_is_splatam_s_loop(render_room, room_frames):
    """All Gaussians are in view all the time here, so that the sparse Adam and torch's are the same."""
    frame = render_room(room_frames[0].world_from_camera, PinholeCamera.from_size(24, 18))
    # Two Gaussians at the same depth may be blended in either order; noise leaves none.
    frame.depth[:] *= 1.0 + 0.01 * np.random.default_rng(0).standard_normal(frame.depth.shape)
    frame.depth[:3, :5] = 0.0  # no return: no depth term, but a colour
    mapper = _mapper()
    mapper.observe(frame, iterations=0)
    seeds = mapper.map.parameters[:, : mapper.map.count].astype(np.float64)
    mapper.refine(8)  # an event of its own on the only keyframe
    found = mapper.map.parameters[:, : mapper.map.count]
    mean, scale, logit, color = _event_in_torch(seeds, frame, 8)
    moved = np.abs(found - seeds).max(axis=1)
    assert moved[:3].max() > 5e-4 and moved[7] > 5e-3 and moved[10] > 0.2 and moved[11:].max() > 0.01
    differences = [found[:3] - mean.T, found[7] - scale[:, 0], found[10] - logit, found[11:] - color.T]
    assert all(np.abs(difference).max() < 1e-3 for difference in differences)


def test_balls_stay_balls(room_frames):
    mapper = _mapper(iterations=4)
    for frame in room_frames[:4]:
        mapper.observe(frame)
    scales = mapper.map.parameters[7:10, : mapper.map.count]
    assert np.array_equal(scales[0], scales[1]) and np.array_equal(scales[0], scales[2])
    assert np.ptp(scales[0]) > 0


def test_ellipsoids_that_begin_as_balls_are_not_turned(room_frames):
    """The axes of a surface would make balls of different shape after the first step."""
    mapper = _mapper(iterations=0, isotropic=False, seed_thickness=1.0, border_sigmas=None)
    mapper.observe(room_frames[0])
    seeds = mapper.map.parameters[:, : mapper.map.count]
    assert (seeds[3:7].T == [1, 0, 0, 0]).all() and np.ptp(seeds[7:10], axis=0).max() == 0.0
    assert mapper.map.count > 100


@pytest.mark.parametrize("of_returns", [True, False])
def test_the_psnr_of_a_keyframe_is_that_of_pixels_with_a_return(of_returns):
    """Half of the image has no return, and so no Gaussian: it is black there, and white in the frame."""
    depth = np.where(np.arange(8) < 4, 2.0, 0.0)
    frame = dataclasses.replace(_frame(depth), rgb=np.full((6, 8, 3), 255, np.uint8))
    mapper = _mapper(iterations=0, psnr_of_returns=of_returns)
    mapper.observe(frame)
    shown = np.clip(mapper.render(frame.camera, frame.world_from_camera).color, 0.0, 1.0)
    error = (1.0 - shown.astype(float)) ** 2
    expected = error[:, :4].sum() / error.size if of_returns else error.mean()
    assert mapper.keyframe_psnr()[0] == pytest.approx(-10.0 * np.log10(expected), abs=1e-3)


def test_every_event_starts_a_new_adam(room_frames):
    """The moments after an event are those of its own steps: they do not know what stood there before."""
    events = []
    for junk in (0.0, 7.0):
        mapper = _mapper()
        mapper.observe(room_frames[0], iterations=3)
        mapper.map.first_moment[:] += junk
        mapper.map.second_moment[:] += junk
        mapper.refine(2)
        events.append(mapper.map)
    assert np.array_equal(events[0].parameters, events[1].parameters)
    live = slice(0, events[0].count)
    assert np.array_equal(events[0].second_moment[:, live], events[1].second_moment[:, live])

    kept = _mapper(adam_reset=False)
    kept.observe(room_frames[0], iterations=3)
    before = kept.map.second_moment[:, : kept.map.count].copy()
    kept.refine(0)
    assert np.array_equal(kept.map.second_moment[:, : kept.map.count], before) and before.any()


def test_pruning_comes_before_the_first_step(room_frames):
    mapper = _mapper()
    count = mapper.observe(room_frames[0], iterations=1).count
    mapper.map.parameters[10, :3] = -8.0  # opacity .0003
    assert mapper.refine(0).pruned == 0 and mapper.map.count == count
    report = mapper.refine(1)
    assert report.pruned == 3 and mapper.map.count == count - 3
    mapper.map.parameters[10, : mapper.map.count] = -8.0
    assert mapper.refine(5).count == 0  # nothing left to step


def test_pruning_comes_twice_in_a_long_event(room_frames, monkeypatch):
    mapper = _mapper()
    mapper.observe(room_frames[0])
    steps, pruned_at = [], []
    step, prune = cpu.mapping_step, mapper._prune
    monkeypatch.setattr(cpu, "mapping_step", lambda *args, **kwargs: steps.append(0) or step(*args, **kwargs))
    monkeypatch.setattr(mapper, "_prune", lambda changed: pruned_at.append(len(steps)) or prune(changed))
    mapper.refine(60)
    assert len(steps) == 60 and pruned_at == [0, 20]


def test_first_half_local_second_half_global(room_frames):
    mapper = _mapper(iterations=8, global_psnr=0.0)  # global are only those that opened new space
    for frame in room_frames[:3]:
        mapper.observe(frame)
    mapper.observe(room_frames[2])  # sees nothing new
    assert [share > 0.1 for share in mapper._store.new_share] == [True, True, True, False]
    report = mapper.observe(room_frames[2])
    assert len(report.views) == 8
    assert set(report.views[4:]) <= {0, 1, 2}
    assert report.views[0] == 4 and set(report.views[:4]) <= {0, 1, 2, 3, 4}


def test_the_bound_is_the_default_mapper_s(room_frames):
    mapper = _mapper(max_gaussians=1000, iterations=0, seed_columns=40)
    reports = [mapper.observe(frame) for frame in room_frames[:3]]
    assert (reports[0].added, reports[0].left_out) == (22 * 40, 0)
    assert (reports[1].added, reports[2].added) == (120, 0)
    assert reports[1].left_out > 0 and reports[2].left_out > 0 and reports[2].count == 1000


def test_a_room_is_mapped(room_frames, held_out_frames):
    mapper = _mapper()
    for frame in room_frames:
        mapper.observe(frame)
    mapper.refine(60)
    errors, psnr = [], []
    for frame in held_out_frames:
        shown = mapper.render(frame.camera, frame.world_from_camera)
        errors.append(np.abs(shown.depth - frame.depth)[shown.alpha > 0.5])
        psnr.append(-10 * np.log10(np.mean((np.clip(shown.color, 0, 1) - frame.rgb / 255.0) ** 2)))
    # Measured: 27.1 dB, 3.8 cm (accumulated depth is too small where alpha is below 1).
    assert np.mean(psnr) > 25
    assert np.median(np.concatenate(errors)) < 0.06
