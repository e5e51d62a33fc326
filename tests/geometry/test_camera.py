"""The pinhole camera and its conventions."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, fibonacci_directions


def test_ninety_degrees_means_focal_length_of_half_the_width() -> None:
    camera = PinholeCamera.from_size(160, 90)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((80, 80, 80, 45))
    # The paper's 60 degrees vertically: 2 atan(45 / 80) = 58.7.
    assert np.degrees(2 * np.arctan(camera.height / 2 / camera.fy)) == pytest.approx(58.7, abs=0.1)


def test_pixel_centres_stand_at_a_half() -> None:
    camera = PinholeCamera(4, 2, 2.0, 2.0, 2.0, 1.0)
    np.testing.assert_allclose(camera.rays()[0, 0], [(0.5 - 2) / 2, (0.5 - 1) / 2, 1])
    np.testing.assert_allclose(camera.rays(2)[0, 0], [(0.25 - 2) / 2, (0.25 - 1) / 2, 1])
    assert camera.rays(3).shape == (6, 12, 3)


def test_projecting_undoes_backprojecting(rng: np.random.Generator) -> None:
    camera = PinholeCamera(20, 10, 11.0, 12.0, 9.5, 5.2)
    depth = rng.uniform(0.5, 5.0, (10, 20))
    pixels = camera.project(camera.backproject(depth))
    u, v = np.meshgrid(np.arange(20) + 0.5, np.arange(10) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([u, v], axis=-1), atol=1e-5)
    np.testing.assert_allclose(camera.matrix @ [0.3, 0.2, 1.0], [*camera.project(np.array([0.3, 0.2, 1.0])), 1.0])


def test_resizing_keeps_the_field_of_view() -> None:
    camera = PinholeCamera.from_size(160, 90).resized(80, 45)
    assert (camera.fx, camera.cx, camera.cy) == pytest.approx((40, 40, 22.5))


@pytest.mark.parametrize("fov", [0.0, 180.0, -1.0])
def test_a_field_of_view_is_checked(fov: float) -> None:
    with pytest.raises(ValueError, match=r"\(0, 180\)"):
        PinholeCamera.from_size(10, 10, fov)


def test_an_image_needs_pixels_and_focal_lengths() -> None:
    with pytest.raises(ValueError, match="at least one pixel"):
        PinholeCamera(0, 3, 1, 1, 0, 0)
    with pytest.raises(ValueError, match="above 0"):
        PinholeCamera(3, 3, 1, -1, 0, 0)


def test_fibonacci_directions_are_unit_and_spread() -> None:
    for count in (1, 5, 15, 200):
        directions = fibonacci_directions(count)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    # Elevations of K = 5 as ActiveGAMER's: +-53.1, +-23.6, 0 degrees.
    elevation = np.degrees(np.arcsin(fibonacci_directions(5)[:, 2]))
    np.testing.assert_allclose(elevation, [53.13, 23.58, 0, -23.58, -53.13], atol=0.01)
    cosine = directions @ directions.T - 2 * np.eye(200)
    # Even spreading of 200 points leaves no neighbour nearer than about 10 degrees.
    assert np.degrees(np.arccos(cosine.max())) > 10.0
    with pytest.raises(ValueError, match="at least 1"):
        fibonacci_directions(0)


def test_what_is_in_the_image_by_hand():
    camera = PinholeCamera.from_size(4, 2, 90.0)  # half a width at depth 1, a quarter of a width up and down
    inside = np.array([[0, 0, 1], [0.99, 0.49, 1], [-0.99, -0.49, 1]])
    outside = np.array([[1.01, 0, 1], [0, 0.51, 1], [0, 0, -1], [0, 0, 0.0]])
    assert camera.in_image(inside).all() and not camera.in_image(outside).any()
