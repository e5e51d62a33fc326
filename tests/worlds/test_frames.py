"""Images of a world as mapping takes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.motion import is_level
from activestructure_gym.worlds import frame_from

CAMERA = PinholeCamera.from_size(8, 4)
RGB = np.full((4, 8, 3), 100, np.uint8)
DEPTH = np.full((4, 8), 2.0, np.float32)


def test_depth_that_is_no_measurement_becomes_zero() -> None:
    depth = DEPTH.copy()
    depth[0, :5] = np.nan, np.inf, -1.0, 10.5, 10.0
    frame = frame_from(RGB, depth.astype(np.float64), np.eye(4), CAMERA, 10.0)
    assert frame.depth[0].tolist() == [0.0, 0.0, 0.0, 0.0, 10.0, 2.0, 2.0, 2.0]
    assert frame.depth.dtype == np.float32 and frame.rgb is not None
    # NaN and negative depth were not measured; infinite depth and depth beyond the range show that nothing is near.
    assert frame.unmeasured is not None
    assert frame.unmeasured[0].tolist() == [True, False, True, False, False, False, False, False]
    assert not frame.unmeasured[1:].any()
    assert frame_from(RGB, DEPTH, np.eye(4), CAMERA, 10.0).unmeasured is None
    of_world = frame_from(RGB, depth, np.eye(4), CAMERA)  # without a range the episode can still apply its sensor's
    again = frame_from(RGB, of_world.depth, np.eye(4), CAMERA, 10.0)
    assert np.array_equal(again.depth, frame.depth) and np.array_equal(again.unmeasured, frame.unmeasured)


def test_images_of_other_sizes_are_resized() -> None:
    rgb = np.zeros((8, 16, 3), np.uint8)
    rgb[:, ::2] = 200  # averaged: 100
    depth = np.full((2, 4, 1), 3.0)
    depth[0, 0] = 1.0
    frame = frame_from(rgb, depth, np.eye(4), CAMERA, 10.0)
    assert frame.rgb.shape == (4, 8, 3) and (frame.rgb == 100).all()
    assert sorted(set(frame.depth.ravel().tolist())) == [1.0, 3.0] and (frame.depth == 1.0).sum() == 4


def test_colours_as_fractions_and_with_alpha() -> None:
    frame = frame_from(np.full((4, 8, 4), 0.5, np.float32), DEPTH, np.eye(4), CAMERA, 10.0)
    assert (frame.rgb == 128).all() and frame.rgb.shape == (4, 8, 3)


def test_depth_in_millimetres_gets_a_warning() -> None:
    depth = DEPTH.copy()
    depth[0, :4] = 0.0, np.nan, np.inf, 65.0
    with pytest.warns(InputWarning, match="above 100 m: if they are in millimetres"):
        frame_from(RGB, 1000.0 * depth, np.eye(4), CAMERA, 10.0)


@pytest.mark.filterwarnings("error")
def test_far_depth_in_metres_gets_no_warning() -> None:
    far = np.full((4, 8), 800.0, np.float32)
    far[0, 0] = 99.0
    nothing = np.full((4, 8), np.inf, np.float32)  # and sensors have large numbers where they see nothing
    for depth in (far, nothing, np.full((4, 8), 1e6), 0.0 * DEPTH):
        frame_from(RGB, depth, np.eye(4), CAMERA, 10.0)


def test_a_camera_may_reuse_its_arrays() -> None:
    rgb, depth, pose = RGB.copy(), DEPTH.copy(), np.eye(4)
    frame = frame_from(rgb, depth, pose, CAMERA, 10.0)
    rgb[:], depth[:], pose[:] = 0, 0.0, 0.0
    assert (frame.rgb == 100).all() and (frame.depth == 2.0).all()
    np.testing.assert_array_equal(frame.world_from_camera, np.eye(4))


@pytest.mark.filterwarnings("error")
def test_numbers_that_rounding_puts_just_outside_are_accepted() -> None:
    rgb = np.full((4, 8, 3), 1.0 + 1e-6)
    rgb[0] = -1e-6
    frame = frame_from(rgb, np.full((4, 8), np.finfo(np.float64).max), np.eye(4), CAMERA, 10.0)
    assert (frame.rgb[0] == 0).all() and (frame.rgb[1:] == 255).all() and not frame.depth.any()


def test_a_pose_rounded_to_three_decimals_becomes_a_rotation_that_is_still_level() -> None:
    errors = []
    for direction in np.random.default_rng(0).standard_normal((200, 3)):
        exact = look_along(np.array([1.0, 2.0, 1.5]), direction)
        given = exact.round(3)
        errors.append(np.abs(given[:3, :3] @ given[:3, :3].T - np.eye(3)).max())
        taken = frame_from(RGB, DEPTH, given, CAMERA, 10.0).world_from_camera
        assert np.abs(taken[:3, :3] @ taken[:3, :3].T - np.eye(3)).max() < 1e-12 < np.abs(taken - exact).max() < 2e-3
        assert is_level(taken)
    assert 1.2e-3 < max(errors) < 1e-3 * 3**0.5  # the limit
    np.testing.assert_array_equal(frame_from(RGB, DEPTH, exact, CAMERA, 10.0).world_from_camera, exact)


@pytest.mark.parametrize(
    ("rgb", "depth", "pose", "message"),
    [
        (RGB[..., 0], DEPTH, np.eye(4), r"a colour image is an array \[H, W, 3\], got shape \(4, 8\)"),
        (RGB.astype(np.int64), DEPTH, np.eye(4), "dtype uint8"),
        (RGB.astype(np.float64), DEPTH, np.eye(4), "values from 0 to 1"),
        (np.full((4, 8, 3), np.nan), DEPTH, np.eye(4), "values from 0 to 1"),
        (np.full((4, 8, 3), -0.01), DEPTH, np.eye(4), "values from 0 to 1"),
        (RGB, DEPTH[0], np.eye(4), r"a depth image is an array \[H, W\]"),
        (RGB, (1000 * DEPTH).astype(np.uint16), np.eye(4), "divide millimetres by 1000"),
        (RGB, np.ones((4, 4), np.float32), np.eye(4), "aspect ratios differ"),
        (np.zeros((0, 8, 3), np.uint8), DEPTH, np.eye(4), "aspect ratios differ"),
        (RGB, DEPTH, np.eye(3), "4x4"),
        (RGB, DEPTH, np.diag([1.0, 1.0, -1.0, 1.0]), "rigid"),
        (RGB, DEPTH, np.full((4, 4), np.nan), "finite"),
        (None, DEPTH, np.eye(4), "colour image"),
    ],
)
def test_other_arrays_are_refused(rgb: Any, depth: Any, pose: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        frame_from(rgb, depth, pose, CAMERA, 10.0)
