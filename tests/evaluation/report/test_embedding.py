import base64
import io

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.report.embedding import data_uri, picture


def opened(uri):
    return Image.open(io.BytesIO(base64.b64decode(uri.partition("base64,")[2])))


def test_a_photograph_is_a_jpeg_and_not_wider_than_the_page_shows():
    rng = np.random.default_rng(0)
    smooth = Image.fromarray(rng.integers(0, 256, (12, 20, 3), dtype=np.uint8)).resize((1120, 630))
    image = opened(data_uri(smooth, drawing=True))
    assert image.format == "JPEG" and image.size == (560, 315)
    np.testing.assert_allclose(np.asarray(image).mean(axis=(0, 1)), np.asarray(smooth).mean(axis=(0, 1)), atol=2)


def test_a_drawing_keeps_its_lines_where_that_is_smaller():
    page = Image.new("RGB", (300, 200), "white")
    ImageDraw.Draw(page).line([(0, 0), (299, 199)], fill=(0, 114, 178), width=2)
    image = opened(data_uri(page, drawing=True))
    assert image.format == "PNG"
    np.testing.assert_array_equal(np.asarray(image.convert("RGB")), np.asarray(page))
    assert 'alt="a &#34;line&#34;"' in picture(page, 'a "line"') and 'width="300"' in picture(page, "")
