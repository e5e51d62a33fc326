"""Pose tracking: exact normals, what depth and colour each determine, when a result is not believed."""

import dataclasses

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along, rotation_angle, se3_exp
from activestructure_gym.mapping.downsampling import reduced
from activestructure_gym.mapping.tracking import (
    TrackingConfig,
    _smoothed,
    shared_keyframes,
    surface_normals,
    track_pose,
)

CAMERA = PinholeCamera.from_size(80, 45)
CONFIG = TrackingConfig(iterations=20)
# 2 cm and 1 degree per axis, once with every sign
MOVED = np.array([0.02, -0.02, 0.02, 0.0175, 0.0175, -0.0175])


def _track(frame, keyframes, moved, config=CONFIG):
    """Reported by ``moved`` too far; what comes back and its error in metres and degrees."""
    reported = frame.world_from_camera @ se3_exp(moved)
    found = track_pose(
        dataclasses.replace(frame, world_from_camera=reported), keyframes, config, sigma_m=0.02, sigma_deg=1.0
    )
    error = found.world_from_camera[:3, 3] - frame.world_from_camera[:3, 3]
    angle = np.degrees(rotation_angle(found.world_from_camera, frame.world_from_camera))
    return found, error, float(angle), reported


def _gray(frame):
    return dataclasses.replace(frame, rgb=np.full_like(frame.rgb, 128))


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, 0, -1), (-0.4, 0.7, -1), (0.2, 0.1, -0.3)])
def test_normals_are_exact_on_planes_and_undefined_at_borders(normal):
    normal = np.array(normal) / np.linalg.norm(normal)
    along_ray = -CAMERA.rays() @ normal
    depth = np.where(along_ray > 0.2, 2.0 / np.maximum(along_ray, 1e-9), 0.0).astype(np.float32)
    points, normals, defined = surface_normals(depth, CAMERA)
    assert np.abs(normals[defined] - normal).max() < 1e-3
    assert points[defined] @ normal == pytest.approx(-2.0, abs=1e-4)
    assert not defined[[0, -1]].any() and not defined[:, [0, -1]].any() and not defined[depth == 0].any()
    assert defined[1:-1, 1:-1][(depth > 0)[1:-1, 1:-1]].mean() > 0.9


def test_normals_are_undefined_across_a_depth_edge():
    depth = np.full((45, 80), 2.0, np.float32)
    depth[:, 40:] = 3.0
    _, _, defined = surface_normals(depth, CAMERA)
    assert not defined[:, 39:41].any() and defined[1:-1, 1:38].all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_room_s_pose_is_found_again(render_room, sign):
    """Reference and frame are 0.3 m and 20 degrees apart."""
    reference = render_room(look_along(np.array([1.4, 1.3, 1.2]), np.array([1.0, 0.3, -0.1])))
    frame = render_room(look_along(np.array([1.6, 1.5, 1.3]), np.array([1.0, 0.7, 0.05])))
    found, error, angle, reported = _track(frame, [reference], sign * MOVED)
    assert found.believed and 5 <= found.steps <= 20 and found.points > 300
    assert np.linalg.norm(reported[:3, 3] - frame.world_from_camera[:3, 3]) > 0.03
    assert np.linalg.norm(error) < 0.004 and angle < 0.15


def test_in_a_gray_room_three_planes_are_enough(render_room):
    """Two walls and the floor: every direction is the normal of something."""
    reference = _gray(render_room(look_along(np.array([2.5, 1.6, 1.3]), np.array([1.0, 0.8, -0.6]))))
    frame = _gray(render_room(look_along(np.array([2.4, 1.7, 1.3]), np.array([1.0, 0.7, -0.7]))))
    _, error, angle, _ = _track(frame, [reference], MOVED)
    assert np.linalg.norm(error) < 0.002 and angle < 0.1


def test_on_one_wall_depth_finds_the_distance_and_colour_the_rest(render_room):
    """The wall x = 4, from .8 m: nothing else is in view. Gray, the slide along it stays as reported."""
    pose = look_along(np.array([3.2, 1.5, 1.25]), np.array([1.0, 0.0, 0.0]))
    near = look_along(np.array([3.15, 1.45, 1.2]), np.array([1.0, 0.03, 0.0]))
    frame, reference = render_room(pose), render_room(near)
    assert frame.depth.max() < 0.81 and reference.depth.max() < 1.0
    moved = np.array([0.02, 0.02, 0.02, 0.0, 0.0, 0.0])
    _, gray, _, reported = _track(_gray(frame), [_gray(reference)], moved)
    assert abs(gray[0]) < 1e-3
    assert gray[1:] == pytest.approx((reported - pose)[1:3, 3], abs=2e-3)
    _, colored, angle, _ = _track(frame, [reference], moved)
    assert np.linalg.norm(colored) < 0.004 and angle < 0.3


def test_without_anything_in_common_the_reported_pose_stands(render_room):
    frame = render_room(look_along(np.array([2.0, 1.5, 1.2]), np.array([1.0, 0, 0])))
    behind = render_room(look_along(np.array([2.0, 1.5, 1.2]), np.array([-1.0, 0, 0])))
    blind = dataclasses.replace(frame, depth=np.zeros_like(frame.depth))
    for candidate, keyframes in ((frame, []), (frame, [behind]), (blind, [frame]), (frame, [blind])):
        found, _, _, reported = _track(candidate, keyframes, MOVED)
        assert not found.believed and found.steps == 0
        assert np.array_equal(found.world_from_camera, reported)


def test_a_result_far_from_the_reported_pose_is_not_believed(render_room):
    """The keyframe's own pose is off by 15 cm: aligned with it, the frame would be seven expected errors away."""
    pose = look_along(np.array([2.5, 1.6, 1.3]), np.array([1.0, 0.8, -0.6]))
    frame = render_room(pose)
    wrong = pose.copy()
    wrong[0, 3] += 0.15
    keyframe = dataclasses.replace(frame, world_from_camera=wrong)
    found, _, _, reported = _track(frame, [keyframe], np.zeros(6))
    assert not found.believed and np.array_equal(found.world_from_camera, reported)
    trusting, error, _, _ = _track(frame, [keyframe], np.zeros(6), dataclasses.replace(CONFIG, gate=50.0))
    assert trusting.believed and error[0] == pytest.approx(0.15, abs=0.01)


def test_the_keyframes_that_share_most_come_first(render_room):
    here = np.array([2.0, 1.5, 1.2])
    turned = [
        render_room(look_along(here, np.array([np.cos(a), np.sin(a), 0]))) for a in np.radians([60, 10, 180, 30, 0])
    ]
    assert shared_keyframes(turned[4], turned[:4], limit=10, reach=0.1) == [1, 3, 0]
    assert shared_keyframes(turned[4], turned[:4], limit=2, reach=0.1) == [1, 3]
    # Same pixels, but another surface in front of what the frame sees.
    hidden = dataclasses.replace(turned[1], depth=0.5 * turned[1].depth)
    assert shared_keyframes(turned[4], [hidden, turned[3]], limit=10, reach=0.1) == [1]


def test_tracking_changes_neither_frame_nor_keyframes(render_room):
    reference = render_room(look_along(np.array([1.4, 1.3, 1.2]), np.array([1.0, 0.3, -0.1])))
    frame = render_room(look_along(np.array([1.6, 1.5, 1.3]), np.array([1.0, 0.5, 0.05])))
    before = [array.copy() for f in (reference, frame) for array in (f.rgb, f.depth, f.world_from_camera)]
    first, _, _, _ = _track(frame, [reference], MOVED)
    second, _, _, _ = _track(frame, [reference], MOVED)
    assert np.array_equal(first.world_from_camera, second.world_from_camera)
    after = [array for f in (reference, frame) for array in (f.rgb, f.depth, f.world_from_camera)]
    assert all(np.array_equal(one, other) for one, other in zip(before, after))
    rotation = first.world_from_camera[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        {"iterations": -1},
        {"references": 0},
        {"pixels": 0},
        {"depth_sigma": 0.0},
        {"gate": float("nan")},
        {"blurs_deg": ()},
        {"reaches": (0.1, 0.0)},
    ],
)
def test_wrong_values_are_refused_by_name(change):
    with pytest.raises(ValueError, match=f"tracking {next(iter(change))}"):
        TrackingConfig(**change)


@pytest.mark.parametrize("factor", [2, 5])
def test_a_keyframe_with_fewer_pixels_is_blurred_by_the_same_angle(render_room, factor):
    """So that it looks like the frame it is compared with: blurred by as many pixels it is off by up to .14."""
    pose = look_along(np.array([1.4, 1.3, 1.2]), np.array([1.0, 0.3, -0.1]))
    frame = render_room(pose, PinholeCamera.from_size(160, 90))
    whole, small = _smoothed(frame, 1.4), _smoothed(reduced(frame, factor), 1.4)
    blocks = whole.reshape(90 // factor, factor, 160 // factor, factor, 3).mean(axis=(1, 3))
    inside = slice(2, -2)  # beside the border the picture ends
    assert np.abs(small - blocks)[inside, inside].max() < 0.03
