"""The mapper as a whole: seeding, optimisation, pruning, the bound, and a room mapped from twelve frames."""

import pickle

import numpy as np
import pytest
from scipy.spatial import cKDTree

from activestructure_gym.geometry import look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping import Mapper, MapperConfig


def _mapper(seed=0, **config):
    return Mapper(MapperConfig(**config), np.random.default_rng(seed))


def _psnr(shown, rgb):
    return -10 * np.log10(np.mean((np.clip(shown, 0, 1) - rgb / 255.0) ** 2))


def test_first_frame_fills_the_image_and_a_second_look_adds_nothing(room_frames):
    mapper = _mapper()
    first = mapper.observe(room_frames[0])
    assert first.added == first.count > 1000 and first.new_share == 1.0
    shown = mapper.render(room_frames[0].camera, room_frames[0].world_from_camera)
    assert (shown.alpha > 0.9).mean() > 0.99
    again = mapper.observe(room_frames[0])
    # Nothing but what a step of the optimiser moved past the spacing.
    assert again.added < 0.02 * first.added and again.new_share < 0.02
    assert len(mapper.keyframes) == 2 and again.count == mapper.map.count


def test_loss_falls_on_a_static_view(room_frames):
    mapper = _mapper(refine_shapes=True)
    before = mapper.observe(room_frames[0], iterations=1)
    after = mapper.refine(60)
    last = mapper.refine(5)
    assert last.color_loss < 0.5 * before.color_loss
    assert last.depth_loss < 0.01
    assert last.ssim > before.ssim
    assert after.views == (0,) * 60 and after.added == 0


def test_room_from_twelve_frames(room_frames, held_out_frames):
    mapper = _mapper()
    for frame in room_frames:
        report = mapper.observe(frame)
    psnr, errors, covered = [], [], []
    for frame in held_out_frames:
        shown = mapper.render(frame.camera, frame.world_from_camera)
        mask = shown.alpha > 0.5
        psnr.append(_psnr(shown.color, frame.rgb))
        errors.append(np.abs(shown.depth / np.maximum(shown.alpha, 1e-9) - frame.depth)[mask])
        covered.append(mask.mean())
    # Measured: 30 dB, .7 cm, 99.9 %.
    assert np.mean(psnr) > 27
    assert np.median(np.concatenate(errors)) < 0.015
    assert np.mean(covered) > 0.99
    alone = [_mapper(iterations=0).observe(frame).added for frame in room_frames]
    assert report.count == mapper.map.count < 0.8 * sum(alone)  # overlap is not seeded twice
    values = mapper.keyframe_psnr()
    assert values.shape == (12,) and values.min() > 25
    assert values[3] == pytest.approx(
        _psnr(mapper.render(room_frames[3].camera, room_frames[3].world_from_camera).color, room_frames[3].rgb)
    )


def test_black_walls_stay_opaque(room_frames):
    """On the black background a transparent Gaussian looks like a black one; only the depth tells them apart."""
    frame = room_frames[0]
    black = Frame(np.zeros_like(frame.rgb), frame.depth, frame.world_from_camera, frame.camera)
    mapper = _mapper()
    mapper.observe(black)
    mapper.map.parameters[11:14] += 0.05  # the little too bright that makes transparency attractive
    mapper.refine(100)
    alpha = mapper.render(black.camera, black.world_from_camera).alpha
    assert (alpha > 0.5).mean() > 0.99


def test_refinement_improves_the_keyframes_it_is_given(room_frames):
    mapper = _mapper()
    for frame in room_frames[:4]:
        mapper.observe(frame, iterations=1)
    before = mapper.keyframe_psnr()
    report = mapper.refine(40, keyframe_indices=[1, 3])
    assert set(report.views) == {1, 3} and report.views.count(1) == 20  # in turn, not by chance
    assert (mapper.keyframe_psnr()[[1, 3]] > before[[1, 3]] + 1).all()
    with pytest.raises(ValueError, match="keyframe indices"):
        mapper.refine(1, keyframe_indices=[4])


def test_keyframe_psnr_renders_a_bounded_number_the_oldest_and_the_worst(room_frames):
    mapper = _mapper(psnr_refresh=0)
    for frame in room_frames[:7]:
        mapper.observe(frame, iterations=1)
    old = mapper.keyframe_psnr(renders=0)
    mapper.refine(60)
    assert np.array_equal(mapper.keyframe_psnr(renders=0), old)  # as they were measured
    new = mapper.keyframe_psnr(renders=3)
    worst = [k for k in np.argsort(old) if k != 0][:2]
    assert sorted(np.flatnonzero(new != old)) == sorted([0, *worst])  # the first was measured first
    # A quarter, rounded up, of every call's renders goes to the oldest: none is older than so many calls.
    for _ in range(6):
        mapper.keyframe_psnr(renders=3)
    exact = mapper.keyframe_psnr(renders=None)
    assert np.array_equal(mapper.keyframe_psnr(renders=0), exact) and (exact > old).mean() > 0.5


def test_no_keyframes_psnr_waits_for_ever(room_frames):
    mapper = _mapper(psnr_refresh=0)
    for frame in room_frames[:6]:
        mapper.observe(frame, iterations=1)
    mapper.keyframe_psnr(renders=None)
    mapper._store.psnr[5] = 99.0  # never among the worst, and wrong
    for _ in range(6):
        known = mapper.keyframe_psnr(renders=2)
    assert known[5] < 60.0


def test_same_seed_same_parameters(room_frames):
    maps = []
    for seed in (0, 0, 1):
        mapper = _mapper(seed)
        for frame in room_frames[:5]:
            mapper.observe(frame)
        mapper.refine(7)
        maps.append(mapper.map.parameters[:, : mapper.map.count].copy())
    assert maps[0].tobytes() == maps[1].tobytes()
    assert maps[0].shape != maps[2].shape or not np.array_equal(maps[0], maps[2])


def test_a_pickled_mapper_goes_on_as_the_original(room_frames):
    mapper = _mapper()
    for frame in room_frames[:3]:
        mapper.observe(frame)
    copy = pickle.loads(pickle.dumps(mapper))
    assert mapper.observe(room_frames[3]) == copy.observe(room_frames[3])
    assert np.array_equal(mapper.map.parameters[:, : mapper.map.count], copy.map.parameters[:, : copy.map.count])


def test_pruning_by_opacity_and_size(room_frames):
    mapper = _mapper(scene_radius=2.0)  # larger than .2 m goes
    mapper.observe(room_frames[0], iterations=0)
    logit = np.log(0.005 / 0.995)
    live = mapper.map.parameters
    live[10, :3] = logit + np.array([-0.01, 0.01, 5.0])  # only the first is too transparent
    live[7:10, 10:13] = np.log([[0.21, 0.19, 0.1], [0.1, 0.1, 0.1], [0.1, 0.1, 0.21]])  # the first and the third
    live[0, 20] = np.nan
    live[12, 21] = np.inf
    expected = np.delete(np.arange(mapper.map.count), [0, 10, 12, 20, 21])
    survivors = {column.tobytes() for column in live[:, expected].T}
    assert mapper.refine(0).pruned == 5
    assert {column.tobytes() for column in mapper.map.parameters[:, : mapper.map.count].T} == survivors


def test_coarse_seeds_survive_pruning(room_frames):
    """Seeds 40 cm apart have sigmas of .36 m, above a tenth of the scene radius."""
    mapper = _mapper(seed_spacing=0.4, seed_pixels=40.0, iterations=0)
    report = mapper.observe(room_frames[0])
    assert mapper.map.scales.max() > 0.1 * mapper.scene_radius
    assert report.pruned == 0 and report.count == report.added > 0


def test_coming_closer_replaces_coarse_gaussians_by_fine_ones(render_room):
    """From 2.6 m pixels of the far wall are 6.5 cm wide: seeds of 1.05 * 4.5 cm. From .4 m, where painted tiles end,
    1.05 * 1.2 cm."""
    far, near = (render_room(look_along(np.array([x, 1.5, 1.2]), np.array([1.0, 0, 0]))) for x in (1.4, 3.6))
    mapper = _mapper()
    mapper.observe(far, iterations=0)
    report = mapper.observe(near, iterations=0)  # which would learn how wide they are
    assert report.replaced > 0 and report.added > 2 * report.replaced
    means, scales = mapper.map.means, mapper.map.scales
    seen = (means[:, 0] > 3.9) & (np.abs(means[:, 1] - 1.5) < 0.02) & (np.abs(means[:, 2] - 1.2) < 0.15)  # a tile's end
    assert seen.sum() > 10 and np.median(scales[seen].max(axis=1)) == pytest.approx(1.05 * 0.012, rel=0.05)
    assert mapper.observe(far).replaced == 0  # going back replaces nothing

    kept = _mapper(coarse_ratio=None)
    kept.observe(far)
    assert kept.observe(near).replaced == 0


def test_the_bound_is_never_exceeded_and_what_is_left_out_is_said(room_frames):
    free, mapper = _mapper(iterations=0), _mapper(max_gaussians=2500, iterations=1)
    wanted = [free.observe(frame).added for frame in room_frames]
    reports = [mapper.observe(frame) for frame in room_frames]
    assert sum(wanted) > 5000 and all(report.count <= 2500 for report in reports)
    assert reports[0].added + reports[0].left_out == wanted[0]
    assert reports[-1].count == 2500 and reports[-1].added == reports[-1].pruned == 0 < reports[-1].left_out
    assert all(report.left_out == 0 for report in reports if report.count < 2500)


def test_refining_helps_views_that_were_not_taken_and_stays_on_the_surface(room_frames, held_out_frames):
    """What is seen of the room: a point of a wall, the floor or the ceiling, for every pixel of the held-out views."""
    mapper = _mapper()
    for frame in room_frames:
        mapper.observe(frame)

    def psnr():
        shown = [mapper.render(frame.camera, frame.world_from_camera).color for frame in held_out_frames]
        return np.mean([_psnr(color, frame.rgb) for color, frame in zip(shown, held_out_frames)])

    points = []
    for frame in held_out_frames:
        local = frame.camera.backproject(frame.depth).reshape(-1, 3)
        points.append(local @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3])
    points = np.concatenate(points)

    def covered():
        return (cKDTree(mapper.map.means).query(points)[0] <= 0.05).mean()

    before, share = psnr(), covered()
    shapes, ids = mapper.map.parameters[:11, : mapper.map.count].copy(), mapper.map.ids[: mapper.map.count].copy()
    mapper.refine(100)
    assert np.array_equal(mapper.map.parameters[:11, : mapper.map.count], shapes)
    assert np.array_equal(mapper.map.ids[: mapper.map.count], ids)
    assert psnr() > before + 0.05 and covered() == share > 0.999


def test_a_frame_without_returns_is_no_error(room_frames):
    blind = Frame(room_frames[0].rgb, np.zeros((45, 80), np.float32), np.eye(4), room_frames[0].camera)
    mapper = _mapper()
    report = mapper.observe(blind)
    assert report.count == 0 and np.isnan(report.color_loss) and report.new_share == 0
    assert mapper.observe(room_frames[0]).count > 0
    assert mapper.observe(blind).added == 0


def test_scene_radius_follows_the_largest_depth(room_frames):
    mapper = _mapper(iterations=0)
    for frame in room_frames[:3]:
        mapper.observe(frame)
    assert mapper.scene_radius == pytest.approx(max(frame.depth.max() for frame in room_frames[:3]) / 3)
    assert _mapper(scene_radius=7.0).scene_radius == 7.0


def test_render_depth_alpha_matches_render(room_frames):
    mapper = _mapper()
    for frame in room_frames[:3]:
        mapper.observe(frame)
    poses = np.stack([room_frames[1].world_from_camera, look_along(np.array([2, 1.5, 1.2]), np.array([0, 1, 0.1]))])
    depth, alpha = mapper.render_depth_alpha(room_frames[0].camera, poses)
    for k, pose in enumerate(poses):
        shown = mapper.render(room_frames[0].camera, pose)
        assert depth[k] == pytest.approx(shown.depth, abs=1e-4)
        assert alpha[k] == pytest.approx(shown.alpha, abs=1e-4)


def test_frames_whose_arrays_do_not_fit_their_camera_are_refused(room_frames):
    wrong = Frame(room_frames[0].rgb, np.ones((40, 80), np.float32), np.eye(4), room_frames[0].camera)
    with pytest.raises(ValueError, match="camera has"):
        _mapper().observe(wrong)


def test_a_large_map_is_put_into_spatial_order_and_stays_the_same_map(room_frames):
    in_order, as_seeded = (Mapper(MapperConfig(), np.random.default_rng(0)) for _ in range(2))
    in_order._ordered_above = 3000  # small enough for these frames
    for frame in room_frames[:6]:
        in_order.observe(frame)
        as_seeded.observe(frame)
    assert in_order._ordered_above > 3000  # it was done
    a, b = in_order.map, as_seeded.map
    assert (np.diff(a.ids[: a.count]) < 0).mean() > 0.2 > (np.diff(b.ids[: b.count]) < 0).mean()
    assert abs(a.count - b.count) <= 0.01 * b.count
    apart = cKDTree(b.means).query(a.means)[0]
    assert np.quantile(apart, 0.95) < 1e-3  # metres: the steps add the same numbers in another order
    np.testing.assert_allclose(in_order.keyframe_psnr(), as_seeded.keyframe_psnr(), atol=0.1)
