"""Compute the opacity of the points of a mesh part, in the same way for all file formats.

A part has a factor, values at its vertices and an image; the opacity of a point is their product. Points below the
cutoff are removed, all others are solid: see `cut_out`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from activestructure_gym.scenes.loaders.images import eight_bits
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

if TYPE_CHECKING:
    from PIL.Image import Image

SOLID_FROM = 0.5  # minimum opacity of a solid point, for formats without their own cutoff
# Pixels; larger images are shrunk. It does not depend on the option max_texture, which must not change the geometry.
MAX_PICTURE_SIDE = 1024
_ROUNDING = 1e-6  # tolerance of the cutoff, since 0.7 in float32 is less than 0.7
_LUMINANCE = (0.2126, 0.7152, 0.0722)  # weights of red, green and blue (ITU-R BT.709)


@dataclass(frozen=True)
class Opacity:
    """Hold the opacity of a part's points, 0 to 1, and the cutoff above which they are solid."""

    factor: float = 1.0
    cutoff: float = SOLID_FROM
    vertices: np.ndarray | None = None  # [V]
    picture: np.ndarray | None = None  # [h, w] uint8
    uv: np.ndarray | None = None  # [V, 2] image coordinates, v down from the top row
    wrap: tuple[int, int] = (REPEAT, REPEAT)  # wrap modes of the image, across and down
    blended: bool = True  # True: solid parts may be translucent in the file; False: the file has its own cutoff

    @property
    def threshold(self) -> float:
        """Return the minimum opacity of a solid point."""
        return self.cutoff - _ROUNDING

    def at_vertices(self, count: int) -> np.ndarray:  # [V]
        """Return the opacity of ``count`` vertices without the image: factor times vertex value, at least 0.

        Values that are missing or not finite count as 1.
        """
        values = np.ones(count) if self.vertices is None else np.asarray(self.vertices, dtype=np.float64)
        return np.maximum(np.where(np.isfinite(values), values, 1.0) * self.factor, 0.0)


class OpacityPicture:
    """Look up the opacity in an image: bilinear values, as in the renderers, and bounds over rectangles."""

    def __init__(self, picture: np.ndarray, wrap: tuple[int, int]) -> None:
        self.size = np.array(picture.shape[::-1])  # pixels across and down, in the order of coordinates
        self._clamps = tuple(mode == CLAMP for mode in wrap)
        for axis, mode in zip((1, 0), wrap):
            if mode == MIRROR:  # equivalent to repeating the image and its mirror image
                picture = np.concatenate([picture, np.flip(picture, axis)], axis)
        # Level k: minima and maxima over the square of 2^k x 2^k pixels that starts at each pixel.
        self._lowest, self._highest = [picture], [picture]
        for level in range((max(picture.shape) - 1).bit_length()):
            self._lowest.append(self._doubled(self._lowest[-1], 1 << level, np.minimum))
            self._highest.append(self._doubled(self._highest[-1], 1 << level, np.maximum))

    def _doubled(self, squares: np.ndarray, side: int, join: np.ufunc) -> np.ndarray:
        for axis, clamps in zip((1, 0), self._clamps):
            places = self._inside(np.arange(squares.shape[axis]) + side, squares.shape[axis], clamps)
            squares = join(squares, np.take(squares, places, axis))
        return squares

    @staticmethod
    def _inside(places: np.ndarray, count: int, clamps: bool) -> np.ndarray:
        return np.clip(places, 0, count - 1) if clamps else places % count

    def _take(self, table: np.ndarray, across: np.ndarray, down: np.ndarray) -> np.ndarray:
        height, width = table.shape
        return table[self._inside(down, height, self._clamps[1]), self._inside(across, width, self._clamps[0])]

    def at(self, pixels: np.ndarray) -> np.ndarray:  # [..., 2] pixels from the corner -> [...] in 0..1
        """Return the opacity at the positions ``pixels``, bilinear between pixel centres."""
        corner = np.floor(pixels - 0.5)
        (x, y), (right, below) = np.moveaxis(corner.astype(np.int64), -1, 0), np.moveaxis(pixels - 0.5 - corner, -1, 0)
        upper, lower = (
            (1.0 - right) * self._take(self._lowest[0], x, row) + right * self._take(self._lowest[0], x + 1, row)
            for row in (y, y + 1)
        )
        return ((1.0 - below) * upper + below * lower) / 255.0

    def bounds(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [P, 2] pixels -> [P] each
        """Return lower and upper bounds of the opacity over P rectangles with the corners ``low`` and ``high``.

        The bounds are valid, but not always tight.
        """
        first, last = np.floor(low - 0.5).astype(np.int64), np.floor(high - 0.5).astype(np.int64) + 1
        longest = (last - first + 1).max(axis=1)
        # Four squares of at least half the side length cover the rectangle.
        levels = np.minimum(np.ceil(np.log2(np.maximum(longest / 2, 1))).astype(np.int64), len(self._lowest) - 1)
        lowest, highest = np.empty(len(low)), np.empty(len(low))
        for level in np.unique(levels):
            chosen = levels == level
            x, y = first[chosen].T
            right, below = np.maximum(last[chosen] + 1 - (1 << int(level)), first[chosen]).T
            places = [(a, b) for a in (x, right) for b in (y, below)]
            lowest[chosen] = np.minimum.reduce([self._take(self._lowest[level], a, b) for a, b in places])
            highest[chosen] = np.maximum.reduce([self._take(self._highest[level], a, b) for a, b in places])
        lowest, highest = lowest / 255.0, highest / 255.0
        near = longest <= 3  # at most two cells of four pixel centres along each axis
        lowest[near], highest[near] = self._exact_bounds(low[near], high[near])
        return lowest, highest

    def _exact_bounds(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [P] each
        """Return the exact bounds over rectangles of at most two cells of pixel centres along each axis.

        The opacity is bilinear in a cell, so its extremes are at the corners of the rectangle's parts in each cell.
        """
        seam = np.maximum(np.floor(high - 0.5) + 0.5, low)
        grid = np.stack([low, seam, high])  # [3, P, 2]
        values = [self.at(np.stack([x[:, 0], y[:, 1]], axis=1)) for x in grid for y in grid]
        return np.minimum.reduce(values), np.maximum.reduce(values)


def opacity_picture(image: Image, channel: str) -> np.ndarray | None:  # [h, w] uint8
    """Return one channel of an image as opacity; None if the image lacks it.

    ``channel`` is "alpha", "luminance", "r", "g", "b" or "either". The last means alpha if any alpha is below 1, else
    luminance.
    """
    alpha = _alpha(image) if channel in ("alpha", "either") else None
    if channel == "either":
        channel = "luminance" if alpha is None or np.asarray(alpha).min() == 255 else "alpha"
    if channel == "alpha":
        return None if alpha is None or np.asarray(alpha).min() == 255 else _shrunk(alpha)
    rgb = eight_bits(image).convert("RGB")
    if channel in ("r", "g", "b"):
        return _shrunk(rgb.getchannel(channel.upper()))
    from PIL import Image as images

    grey = np.asarray(rgb, dtype=np.float32) @ np.array(_LUMINANCE, np.float32)
    return _shrunk(images.fromarray(np.rint(grey).astype(np.uint8)))


def _alpha(image: Image) -> Image | None:
    if image.mode in ("RGBA", "LA", "PA", "RGBa", "La"):
        return image.convert("RGBA").getchannel("A")
    if image.mode in ("P", "L", "RGB", "1") and "transparency" in image.info:
        return image.convert("RGBA").getchannel("A")
    return None


def _shrunk(channel: Image) -> np.ndarray:
    from PIL import Image as images

    scale = MAX_PICTURE_SIDE / max(channel.size)
    if scale < 1.0:
        size = (max(1, round(channel.width * scale)), max(1, round(channel.height * scale)))
        channel = channel.resize(size, images.Resampling.BOX)
    return np.ascontiguousarray(channel, dtype=np.uint8)
