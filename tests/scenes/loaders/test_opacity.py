from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.scenes.loaders.opacity import MAX_PICTURE_SIDE, Opacity, OpacityPicture, opacity_picture
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT


def test_a_row_of_two_pixels_by_hand():
    """Centres at 0.5 and 1.5 pixels; outside of them it goes on as the wrap mode says."""
    picture = np.array([[0, 255]], np.uint8)
    across = np.array([0.5, 1.0, 1.5, 2.0, 2.5, -0.5])
    places = np.stack([across, np.full(6, 0.5)], axis=1)
    for wrap, expected in {
        REPEAT: [0, 0.5, 1, 0.5, 0, 1],
        CLAMP: [0, 0.5, 1, 1, 1, 0],
        MIRROR: [0, 0.5, 1, 1, 1, 0],
    }.items():
        np.testing.assert_allclose(OpacityPicture(picture, (wrap, REPEAT)).at(places), expected)


@pytest.mark.parametrize("wrap", [(REPEAT, REPEAT), (CLAMP, MIRROR), (MIRROR, CLAMP)])
@pytest.mark.parametrize("largest", [0.4, 2.0, 40.0])
def test_bounds_hold_for_every_point_of_a_rectangle(rng, wrap, largest):
    picture = OpacityPicture(rng.integers(0, 256, (7, 12)).astype(np.uint8), wrap)
    low = rng.uniform(-30, 40, (300, 2))
    high = low + rng.uniform(0, largest, (300, 2))
    lowest, highest = picture.bounds(low, high)
    inside = picture.at(low[:, None] + rng.random((300, 200, 2)) * (high - low)[:, None])
    assert (inside >= lowest[:, None] - 1e-9).all() and (inside <= highest[:, None] + 1e-9).all()
    if largest < 1:  # and they are tight where cutting ends
        assert np.median(highest - lowest - np.ptp(inside, axis=1)) < 0.02


def test_the_channels_of_a_picture():
    rgba = np.zeros((2, 2, 4), np.uint8)
    rgba[..., 0], rgba[..., 1], rgba[..., 3] = 100, 200, [[0, 255], [255, 255]]
    image = Image.fromarray(rgba)
    for channel, corner in {"alpha": 0, "r": 100, "g": 200, "b": 0, "luminance": 164, "either": 0}.items():
        assert opacity_picture(image, channel)[0, 0] == corner  # 0.2126 * 100 + 0.7152 * 200 = 164.3
    grey = Image.fromarray(np.full((2, 2), 40, np.uint8))
    assert opacity_picture(grey, "alpha") is None and opacity_picture(grey, "either")[0, 0] == 40
    rgba[..., 3] = 255
    full = Image.fromarray(rgba)  # an alpha that says nothing
    assert opacity_picture(full, "alpha") is None and opacity_picture(full, "either")[0, 0] == 164


def test_a_palette_may_have_a_transparent_colour():
    image = Image.fromarray(np.array([[0, 1]], np.uint8)).convert("P")
    image.info["transparency"] = 1
    assert opacity_picture(image, "alpha").tolist() == [[255, 0]]


def test_large_pictures_shrink():
    alpha = np.zeros((2, 2 * MAX_PICTURE_SIDE, 4), np.uint8)
    alpha[:, :MAX_PICTURE_SIDE, 3] = 255
    found = opacity_picture(Image.fromarray(alpha), "alpha")
    assert found.shape == (1, MAX_PICTURE_SIDE) and found[0, MAX_PICTURE_SIDE // 2 - 1 :][:2].tolist() == [255, 0]


def test_values_that_are_not_finite_are_opaque():
    opacity = Opacity(0.5, vertices=np.array([np.nan, np.inf, 1.0, -2.0]))
    assert opacity.at_vertices(4).tolist() == [0.5, 0.5, 0.5, 0.0]
