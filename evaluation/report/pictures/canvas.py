"""Compose images and texts to one image, called page; rendered views are not resampled."""

from __future__ import annotations

import functools
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from activestructure_gym.evaluation.report.style import HAIR, INK, PAPER

Box = tuple[int, int, int, int]  # pixels: left, upper, right and lower edge

_PANELS = "asg:panels-2"  # key of the boxes of the panels in a PNG's text metadata
_MAX_PIXELS = 1 << 26  # largest number of pixels of a stored image that is read
GAP = 6  # pixels between tiles
MARGIN = 14  # pixels around a page
_TITLE, _LABELS = 30, 22  # height of the title and of the column labels in pixels


@functools.cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font Open Sans, which pyrender contains, or Pillow's default font; ``size`` is in pixels."""
    spec = importlib.util.find_spec("pyrender")
    if spec is not None and spec.origin:
        path = Path(spec.origin).parent / "fonts" / f"OpenSans-{'Bold' if bold else 'Regular'}.ttf"
        if path.is_file():
            return ImageFont.truetype(str(path), size)
    return ImageFont.load_default(size)


def text_width(text: str, size: int, *, bold: bool = False) -> int:
    """Return the width of one line of text in pixels, at the font size ``size``."""
    return round(font(size, bold=bold).getlength(text))


def write(
    image: Image.Image,
    position: tuple[float, float],
    text: str,
    *,
    size: int = 15,
    bold: bool = False,
    fill: tuple[int, int, int] = INK,
    anchor: str = "la",
) -> None:
    """Draw one line of text at ``position`` (x, y) into ``image``.

    ``position`` and the font's ``size`` are in pixels, ``fill`` is an RGB colour, and ``anchor`` is Pillow's text
    anchor.
    """
    ImageDraw.Draw(image).text(position, text, font=font(size, bold=bold), fill=fill, anchor=anchor)


def corner_label(image: Image.Image, text: str, *, size: int = 13, at_top: bool = False) -> None:
    """Draw a text on a dark plate in the lower right corner, or in the upper left with ``at_top``."""
    width, height = text_width(text, size, bold=True) + 12, size + 9
    left, top = (0, 0) if at_top else (image.width - width, image.height - height)
    box = (left, top, left + width, top + height)
    plate = Image.new("RGBA", (width, height), (0, 0, 0, 165))
    image.paste(Image.alpha_composite(image.crop(box).convert("RGBA"), plate), (left, top))
    write(image, (left + width / 2, top + height / 2), text, size=size, bold=True, fill=PAPER, anchor="mm")


def paste_framed(page: Image.Image, tile: Image.Image, place: tuple[int, int]) -> None:
    """Paste a tile on a page at ``place`` (x, y), with a thin frame that shows its edge on white."""
    x, y = place
    page.paste(tile, place)
    ImageDraw.Draw(page).rectangle([x - 1, y - 1, x + tile.width, y + tile.height], outline=HAIR)


def tile_grid(
    rows: Sequence[Sequence[Image.Image]],
    *,
    title: str,
    row_labels: Sequence[Sequence[str]] = (),  # lines of text left of each row; the first is bold
    column_labels: Sequence[str] = (),  # text above each column
    frames: bool = True,  # thin lines around the tiles
) -> Image.Image:
    """Return a page with rows of tiles, which all have one size, and with a title, row labels and column labels."""
    tile_width, tile_height = rows[0][0].size
    columns = max(len(row) for row in rows)
    lines = [line for label in row_labels for line in label]
    left = MARGIN + (max(text_width(line, 15, bold=True) for line in lines) + MARGIN if lines else 0)
    top = MARGIN + _TITLE + (_LABELS if column_labels else 0)
    width = max(left + columns * (tile_width + GAP) - GAP, MARGIN + text_width(title, 19, bold=True)) + MARGIN
    page = Image.new("RGB", (width, top + len(rows) * (tile_height + GAP) - GAP + MARGIN), PAPER)
    write(page, (MARGIN, MARGIN), title, size=19, bold=True)
    for column, label in enumerate(column_labels):
        write(page, (left + column * (tile_width + GAP), top - 21), label, size=14)
    for index, row in enumerate(rows):
        y = top + index * (tile_height + GAP)
        for number, line in enumerate(row_labels[index] if row_labels else ()):
            write(page, (MARGIN, y + 4 + 21 * number), line, size=15, bold=number == 0)
        for column, tile in enumerate(row):
            place = left + column * (tile_width + GAP), y
            paste_framed(page, tile, place) if frames else page.paste(tile, place)
    return page


def first_row_boxes(tiles: Sequence[Image.Image]) -> list[Box]:
    """Return the boxes of the first row of tiles on a page of `tile_grid` with column labels, without row labels."""
    (width, height), top = tiles[0].size, MARGIN + _TITLE + _LABELS
    corners = [MARGIN + column * (width + GAP) for column in range(len(tiles))]
    return [(left, top, left + width, top + height) for left in corners]


def to_image(array: np.ndarray) -> Image.Image:
    """Convert an array [H, W, 3] uint8 to an RGB image."""
    return Image.fromarray(np.ascontiguousarray(array), "RGB")


def save_with_panels(image: Image.Image, path: Path, panels: Sequence[Box]) -> None:
    """Save a page as PNG, with the boxes of its panels as metadata that `stored_panels` reads."""
    about = PngInfo()
    about.add_text(_PANELS, json.dumps(panels))
    image.save(path, "PNG", pnginfo=about)


def stored_panels(path: Path) -> list[Image.Image] | None:
    """Return the two panels of a page saved by `save_with_panels`; None if the file has no two panels."""
    page = stored_picture(path)
    if page is None:
        return None
    try:
        boxes = [tuple(int(side) for side in box) for box in json.loads(page.info[_PANELS])]
    except (KeyError, TypeError, ValueError, RecursionError, OverflowError):
        return None
    if len(boxes) != 2 or not all(_is_inside(box, page) for box in boxes):
        return None
    return [page.crop((box[0], box[1], box[2], box[3])).convert("RGB") for box in boxes]


def stored_picture(path: Path) -> Image.Image | None:
    """Return the image of a PNG file; None if the file is missing, damaged or has more than `_MAX_PIXELS` pixels."""
    if not path.is_file():
        return None
    try:
        with Image.open(path, formats=("PNG",)) as picture:
            if picture.width * picture.height > _MAX_PIXELS:
                return None
            picture.load()
            return picture
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # raised by Pillow for damaged files
        return None


def _is_inside(box: Sequence[int], page: Image.Image) -> bool:
    return len(box) == 4 and 0 <= box[0] < box[2] <= page.width and 0 <= box[1] < box[3] <= page.height
