import base64
import io

import numpy as np
import pytest
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.report.page.data_uris import THUMBNAIL, WIDE, data_uri, picture


def opened(uri):
    return Image.open(io.BytesIO(base64.b64decode(uri.removeprefix("data:image/webp;base64,"))))


@pytest.mark.parametrize("widest", [WIDE, THUMBNAIL])
def test_a_picture_is_a_webp_and_not_wider_than_the_page_shows(widest):
    rng = np.random.default_rng(0)
    smooth = Image.fromarray(rng.integers(0, 256, (12, 20, 3), dtype=np.uint8)).resize((1120, 630))
    image = opened(data_uri(smooth, widest=widest))
    assert image.format == "WEBP" and image.size == (widest, round(widest * 630 / 1120))
    np.testing.assert_allclose(np.asarray(image).mean(axis=(0, 1)), np.asarray(smooth).mean(axis=(0, 1)), atol=2)


def test_a_line_stays_a_line_and_has_its_place_before_it_is_loaded():
    page = Image.new("RGB", (300, 200), "white")
    ImageDraw.Draw(page).line([(0, 100), (299, 100)], fill=(0, 114, 178), width=4)
    pixels = np.asarray(opened(data_uri(page)).convert("RGB")).astype(int)
    assert np.abs(pixels[[20, 180]] - 255).max() < 8 and np.abs(pixels[101] - (0, 114, 178)).max() < 40
    text = picture(page, 'a "line"')
    assert 'alt="a &#34;line&#34;"' in text and 'width="300" height="200" loading="lazy"' in text
