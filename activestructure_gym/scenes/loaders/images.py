"""Decode images from untrusted files: only known formats, with a check of the size before decoding."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.scenes.loaders.budget import LimitError

if TYPE_CHECKING:
    from PIL.Image import Image

# Common formats that Pillow decodes itself; for PostScript it would start Ghostscript.
FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "TGA")
MAX_PIXELS = 1 << 26  # 8192 x 8192: 256 MB while decoding
_MAX_SCANS = 100  # maximum number of scans of a progressive JPEG; encoders write about ten, each of all pixels


def opened_image(data: bytes, *, formats: tuple[str, ...] = FORMATS, most_pixels: int = MAX_PIXELS) -> Image:
    """Return the image in ``data``, not yet decoded.

    Raises `LimitError` if it is too large, and Pillow's errors if it is unreadable.
    """
    from PIL import Image as images

    with warnings.catch_warnings():
        # Pillow warns of metadata, and of sizes above a limit that is higher than `most_pixels`.
        warnings.simplefilter("ignore")
        try:
            image = images.open(io.BytesIO(data), formats=formats)
        except images.DecompressionBombError as error:
            raise LimitError(f"has more than {most_pixels:,} pixels") from error
    if image.width * image.height > most_pixels:
        raise LimitError(f"has {image.width} x {image.height} pixels; at most {most_pixels:,} are read")
    if image.format in ("JPEG", "MPO") and data.count(b"\xff\xda") > _MAX_SCANS:
        raise LimitError(f"has more than {_MAX_SCANS} progressive scans")
    return image


def eight_bits(image: Image) -> Image:
    """Return the image with 8 bits per channel; 16-bit and float images are scaled, since Pillow would truncate them.

    Raises `LimitError` if the range of the values fits none of these scales.
    """
    from PIL import Image as images

    if not image.mode.startswith(("I", "F")):
        return image
    values = np.asarray(image, dtype=np.float32)
    low, high = values.min(), values.max()
    if image.mode.startswith("I;16") or (image.mode == "I" and 255 < high <= 65535):
        scale = 1.0 / 257.0
    elif image.mode == "F" and high <= 1.0:
        scale = 255.0
    else:
        scale = 1.0
    if not (low >= 0 and high * scale <= 255.5):
        raise LimitError(
            f"has values from {low:g} to {high:g}; at most 65535 of whole numbers and 255 of floats is read"
        )
    return images.fromarray(np.rint(values * np.float32(scale)).astype(np.uint8))
