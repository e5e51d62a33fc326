"""Pictures inside a page: data URIs, small enough that ninety runs fit into one file."""

from __future__ import annotations

import base64
import io
from typing import Literal

from markupsafe import Markup
from PIL import Image

from activestructure_gym.evaluation.report.html import render

_WIDEST = 560  # pixels; drawings that are larger are made smaller
_QUALITY = 80  # of JPEG
_COLOURS = 64  # of a drawing's palette


def data_uri(image: Image.Image, *, drawing: bool = False, widest: int = _WIDEST) -> str:
    """The image as JPEG; a drawing as PNG with a palette where that is smaller, which keeps its lines clean."""
    if image.width > widest:
        size = widest, max(1, round(image.height * widest / image.width))
        image = image.resize(size, Image.Resampling.LANCZOS)
    image = image.convert("RGB")
    kind, content = "jpeg", _encoded(image, "JPEG", quality=_QUALITY, optimize=True, progressive=True)
    if drawing:
        flat = _encoded(image.quantize(_COLOURS, dither=Image.Dither.NONE), "PNG", optimize=True)
        if len(flat) < len(content):
            kind, content = "png", flat
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


def picture(image: Image.Image, alt: str, *, drawing: bool = False, widest: int = _WIDEST) -> Markup:
    """An ``img`` that needs nothing but the page."""
    source = data_uri(image, drawing=drawing, widest=widest)
    return render("picture.html.j2", source=source, alt=alt, width=image.width, height=image.height)


def _encoded(image: Image.Image, kind: Literal["JPEG", "PNG"], **options: int | bool) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()
