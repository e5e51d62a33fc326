"""Embed images in the page as data URIs, small enough for hundreds of runs in one file."""

from __future__ import annotations

import base64
import io

from markupsafe import Markup
from PIL import Image

from activestructure_gym.evaluation.report.html import render

WIDE, THUMBNAIL = 480, 240  # largest width of an image, and of a thumbnail, in pixels
_QUALITY = 55  # WebP quality, in [0, 100]


def data_uri(image: Image.Image, *, widest: int = WIDE) -> str:
    """Return an image as a data URI in WebP format, at most ``widest`` pixels wide.

    WebP takes half the bytes of JPEG for these images.
    """
    if image.width > widest:
        size = widest, max(1, round(image.height * widest / image.width))
        image = image.resize(size, Image.Resampling.LANCZOS, reducing_gap=2.0)
    buffer = io.BytesIO()
    image.convert("RGB").save(buffer, "WEBP", quality=_QUALITY)
    return f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def picture(image: Image.Image, alt: str, *, widest: int = WIDE) -> Markup:
    """Return an ``img`` element with the embedded image, ``widest`` pixels wide at most; ``alt`` is its description."""
    source = data_uri(image, widest=widest)
    return render("picture.html.j2", source=source, alt=alt, width=image.width, height=image.height)
