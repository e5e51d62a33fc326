"""Pictures inside a page: data URIs, small enough that hundreds of runs fit into one file."""

from __future__ import annotations

import base64
import io

from markupsafe import Markup
from PIL import Image

from activestructure_gym.evaluation.report.html import render

WIDE, THUMBNAIL = 480, 240  # pixels: of a picture that is looked at, of one among many
_QUALITY = 55  # of WebP


def data_uri(image: Image.Image, *, widest: int = WIDE) -> str:
    """The image as WebP: half the bytes of JPEG for photographs and for drawings over them."""
    if image.width > widest:
        size = widest, max(1, round(image.height * widest / image.width))
        image = image.resize(size, Image.Resampling.LANCZOS, reducing_gap=2.0)
    buffer = io.BytesIO()
    image.convert("RGB").save(buffer, "WEBP", quality=_QUALITY)
    return f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def picture(image: Image.Image, alt: str, *, widest: int = WIDE) -> Markup:
    """An ``img`` that needs nothing but the page."""
    source = data_uri(image, widest=widest)
    return render("picture.html.j2", source=source, alt=alt, width=image.width, height=image.height)
