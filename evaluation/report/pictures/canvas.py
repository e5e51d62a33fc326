"""Compose images and text on a page; rendered views are placed without resampling."""

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

_PANELS = "asg:panels-2"  # key of the panel positions in the PNG's text
_MAX_PIXELS = 1 << 26  # of a stored image that is read
GAP = 6  # pixels between tiles
MARGIN = 14
_TITLE, _LABELS = 30, 22  # pixels above the tiles


@functools.cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Open Sans from pyrender's files, or Pillow's default font if that is missing."""
    spec = importlib.util.find_spec("pyrender")
    if spec is not None and spec.origin:
        path = Path(spec.origin).parent / "fonts" / f"OpenSans-{'Bold' if bold else 'Regular'}.ttf"
        if path.is_file():
            return ImageFont.truetype(str(path), size)
    return ImageFont.load_default(size)


def text_width(text: str, size: int, *, bold: bool = False) -> int:
    """Return the width of one line in pixels."""
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
    """Draw one line of text; ``anchor`` is Pillow's."""
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
    """Paste a tile on a page with a thin frame, which shows its edge on a white page."""
    x, y = place
    page.paste(tile, place)
    ImageDraw.Draw(page).rectangle([x - 1, y - 1, x + tile.width, y + tile.height], outline=HAIR)


def tile_grid(
    rows: Sequence[Sequence[Image.Image]],
    *,
    title: str,
    row_labels: Sequence[Sequence[str]] = (),  # lines of text left of each row; the first is bold
    column_labels: Sequence[str] = (),
    frames: bool = True,  # thin lines around the tiles
) -> Image.Image:
    """Return a page of tiles of one size in rows, with a title, row labels and column labels."""
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
    """Return the boxes of the first row on a page of `tile_grid` with column labels and without row labels."""
    (width, height), top = tiles[0].size, MARGIN + _TITLE + _LABELS
    corners = [MARGIN + column * (width + GAP) for column in range(len(tiles))]
    return [(left, top, left + width, top + height) for left in corners]


def to_image(array: np.ndarray) -> Image.Image:
    """Return an RGB image from [H, W, 3] uint8."""
    return Image.fromarray(np.ascontiguousarray(array), "RGB")


def save_with_panels(image: Image.Image, path: Path, panels: Sequence[Box]) -> None:
    """Save a page as PNG, with the boxes of its panels as metadata."""
    about = PngInfo()
    about.add_text(_PANELS, json.dumps(panels))
    image.save(path, "PNG", pnginfo=about)


def stored_panels(path: Path) -> list[Image.Image] | None:
    """Return the two panels of a page that `save_with_panels` saved; None if the file has none."""
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
    """Return the image in a PNG file; None if the file is missing, damaged or larger than this package writes."""
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
