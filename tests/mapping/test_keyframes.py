"""Which keyframes see the same, and which are looked at."""

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.mapping.keyframes import KeyframeStore, draw_views, viewing_sides

CAMERA = PinholeCamera.from_size(60, 40)  # 90 degrees wide


def _store(directions, *, depth=2.0, border_share=0.0):
    store = KeyframeStore(border_share=border_share)
    for direction in directions:
        pose = look_along(np.zeros(3), np.array([*direction, 0.0]))
        store.append(
            Frame(np.zeros((40, 60, 3), np.uint8), np.full((40, 60), depth, np.float32), pose, CAMERA), new_share=0.0
        )
    return store


def test_a_point_is_inside_the_viewing_sides_iff_it_projects_into_the_image():
    rng = np.random.default_rng(0)
    pose = look_along(np.array([1.0, -2.0, 0.5]), np.array([1.0, 0.4, -0.3]))
    camera = PinholeCamera(60, 40, 30.0, 33.0, 25.0, 22.0)
    local = rng.uniform(-3, 3, (2000, 3))
    u, v = camera.project(local).T
    expected = (local[:, 2] > 0) & (u > 5) & (u < 55) & (v > 5) & (v < 35)
    world = local @ pose[:3, :3].T + pose[:3, 3]
    sides = viewing_sides(camera, pose, border_share=5 / 60)
    inside = (sides @ np.c_[world, np.ones(2000)].T.astype(np.float32)).min(axis=0) > 0
    assert 50 < expected.sum() < 1950
    assert (inside != expected).sum() <= 1  # float32 at the border


def test_overlap_by_direction():
    """90 degrees wide: the same direction and 45 degrees overlap, 100 degrees and the back do not."""
    angles = np.radians([0, 0, 45, 100, 180])
    store = _store(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    found = store.overlapping(0, np.random.default_rng(0), pixels=1600, limit=10)
    assert sorted(found) == [1, 2]


def test_overlap_is_a_uniform_choice_of_at_most_limit():
    store = _store([(1.0, 0.01 * k) for k in range(41)])
    rng = np.random.default_rng(0)
    drawn = [store.overlapping(40, rng, pixels=64, limit=10) for _ in range(400)]
    assert all(len(set(d)) == 10 and 40 not in d for d in drawn)
    counts = np.bincount(np.concatenate(drawn), minlength=40)
    # Expected 100 each; five standard deviations of the binomial (8.7) are 43.
    assert counts.min() > 57 and counts.max() < 143


def test_a_frame_without_returns_overlaps_with_nothing():
    store = _store([(1.0, 0.0), (1.0, 0.0)], depth=0.0)
    assert store.overlapping(1, np.random.default_rng(0), pixels=1600, limit=10) == []


def test_the_border_does_not_count():
    """The second camera sees only the outermost half degree of the first one's image."""
    angle = np.radians(89.5)
    store = _store([(1.0, 0.0), (np.cos(angle), np.sin(angle))])
    assert store.overlapping(0, np.random.default_rng(0), pixels=1600, limit=5) == [1]
    store = _store([(1.0, 0.0), (np.cos(angle), np.sin(angle))], border_share=0.05)
    assert store.overlapping(0, np.random.default_rng(0), pixels=1600, limit=5) == []


def test_poor_keyframes():
    store = _store([(1.0, 0.0)] * 5)
    store.psnr[:] = [20.0, 40.0, 30.0, 10.0, 50.0]
    store.new_share[:] = [0.0, 0.0, 0.0, 0.0, 0.5]
    assert store.poor(psnr_threshold=34.0, new_share_threshold=0.1) == [0, 2, 3, 4]
    assert store.poor(psnr_threshold=15.0, new_share_threshold=0.9) == [3]


def test_the_stalest_are_those_measured_longest_ago():
    store = _store([(1.0, 0.0)] * 5)
    for index in (3, 0, 4):
        store.record_psnr(index, 30.0 + index)
    assert store.stalest(10) == [1, 2, 3, 0, 4]  # the never measured first, in their order
    assert store.stalest(0) == []
    # In turn: every keyframe comes once before any comes again.
    turns = []
    for _ in range(10):
        (index,) = store.stalest(1)
        store.record_psnr(index, 20.0)
        turns.append(index)
    assert turns == [1, 2, 3, 0, 4] * 2
    assert store.psnr == [20.0] * 5


def test_measured_anew_are_the_stalest_and_then_the_worst():
    store = _store([(1.0, 0.0)] * 6)
    for index, psnr in zip((5, 2, 0, 1, 4, 3), (31.0, 25.0, 40.0, 20.0, 22.0, 21.0)):
        store.record_psnr(index, psnr)
    assert store.to_measure(oldest=1, count=4) == [5, 1, 3, 4]
    assert store.to_measure(oldest=2, count=4) == [5, 2, 1, 3]  # the second stalest is the fourth worst, too
    assert store.to_measure(oldest=2, count=1) == [5]
    assert store.to_measure(oldest=0, count=0) == []
    assert sorted(store.to_measure(oldest=2, count=9)) == list(range(6))


@pytest.mark.parametrize("iterations", [0, 1, 2, 5, 15])
def test_second_half_goes_to_the_poor(iterations):
    views = draw_views(iterations, [7, 6, 5], [1, 2], np.random.default_rng(0))
    half = (iterations + 1) // 2
    assert len(views) == iterations
    assert set(views[:half]) <= {5, 6, 7} and set(views[half:]) <= {1, 2}
    assert views[:1] in ([], [7])  # the current frame comes first
    assert set(draw_views(iterations, [7], [], np.random.default_rng(0))) <= {7}


def test_frames_are_copied_and_compact():
    """Sensors may write the next image into the same array."""
    store = KeyframeStore(border_share=0.0)
    rgb, depth = np.zeros((40, 60, 3), np.uint8), np.ones((40, 60), np.float32)
    store.append(Frame(rgb, depth, np.eye(4), CAMERA), new_share=0.0)
    rgb[:], depth[:] = 9, 9
    frame = store.frames[0]
    assert not frame.rgb.any() and (frame.depth == 1).all()
    assert frame.rgb.nbytes + frame.depth.nbytes == 7 * 60 * 40


def test_the_bounding_sphere_leaves_out_no_keyframe_that_overlaps():
    rng = np.random.default_rng(4)
    store = KeyframeStore(border_share=0.0)
    for _ in range(60):
        direction = np.append(rng.normal(size=2), rng.uniform(-0.5, 0.5))
        pose = look_along(rng.uniform(-6, 6, 3), direction)
        depth = rng.uniform(1.0, 4.0, (40, 60)).astype(np.float32)
        store.append(Frame(np.zeros((40, 60, 3), np.uint8), depth, pose, CAMERA), new_share=0.0)
    left_out = 0
    for index in range(60):
        points = np.c_[store.frames[index].world_points(), np.ones(2400)].T.astype(np.float32)
        may = store._may_see(points)
        for k in range(60):
            sides = viewing_sides(CAMERA, store.frames[k].world_from_camera)
            assert may[k] or not ((sides @ points).min(axis=0) > 0).any()
        left_out += np.count_nonzero(~may)
    assert left_out > 500  # of 3600: else it would be of no use
