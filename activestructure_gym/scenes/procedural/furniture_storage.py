"""Draw cupboards, shelves, desks and other storage. Sizes are (width, depth, height) in metres."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural.furniture_pen import Pen

Size = tuple[float, float, float]

_SPINES = np.array(
    [
        [0.55, 0.28, 0.24],
        [0.27, 0.36, 0.46],
        [0.72, 0.62, 0.42],
        [0.36, 0.44, 0.34],
        [0.78, 0.75, 0.68],
        [0.33, 0.30, 0.32],
    ]
)


def cupboard_front(
    pen: Pen, x0: float, x1: float, y: float, z0: float, z1: float, role: str, *, handle: str = "bar"
) -> None:
    """Draw a door or drawer front between x0, x1, z0 and z1 (metres), with a gap around it and a handle.

    Its face is at y + 2 cm.
    """
    pen.box((x0 + 0.004, y - 0.001, z0 + 0.004), (x1 - 0.004, y + 0.02, z1 - 0.004), role)
    middle = (x0 + x1) / 2
    if handle == "bar":
        pen.box((middle - 0.07, y + 0.015, z1 - 0.065), (middle + 0.07, y + 0.045, z1 - 0.04), "steel")
    elif handle == "left":
        pen.box((x0 + 0.03, y + 0.015, (z0 + z1) / 2 - 0.1), (x0 + 0.055, y + 0.045, (z0 + z1) / 2 + 0.1), "steel")
    elif handle == "right":
        pen.box((x1 - 0.055, y + 0.015, (z0 + z1) / 2 - 0.1), (x1 - 0.03, y + 0.045, (z0 + z1) / 2 + 0.1), "steel")


def _books(pen: Pen, x0: float, x1: float, back: float, depth: float, z: float, height: float) -> None:
    """Draw a dense row of books from x0 to about x1 with their backs at y = ``back``; all lengths are metres.

    ``depth`` and ``height`` are the space on the shelf at height z; each book fills a random part of it.
    """
    x = x0
    while x < x1 - 0.05:
        thick = pen.rng.uniform(0.028, 0.055)
        tall = height * pen.rng.uniform(0.68, 0.92)
        deep = depth * pen.rng.uniform(0.68, 0.85)
        tone = np.clip(_SPINES[pen.rng.integers(len(_SPINES))] * pen.rng.uniform(0.85, 1.15), 0, 1)
        pen.box((x, back, z), (x + thick, back + deep, z + tall), pen.materials.tinted("linen", tuple(tone)))
        x += thick + 0.002


def shelf(pen: Pen, size: Size) -> None:
    """Draw a bookcase with a back, books and a few ornaments."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    role = "shelf wood"
    pen.box((-x, -y, 0.0), (-x + 0.03, y, height), role)
    pen.box((x - 0.03, -y, 0.0), (x, y, height), role)
    pen.box((-x + 0.03, -y, 0.06), (x - 0.03, -y + 0.015, height - 0.03), role)
    boards = np.linspace(0.05, height - 0.03, 6 if height > 1.5 else 3)
    for z in boards:
        pen.box((-x + 0.03, -y + 0.015, z), (x - 0.03, y - 0.004, z + 0.03), role)
    gap = boards[1] - boards[0] - 0.03
    for z in boards[:-1] + 0.03:
        end = x - 0.04 - (pen.rng.uniform(0.0, 0.45) * width if pen.rng.random() < 0.7 else 0.0)
        _books(pen, -x + 0.035, end, -y + 0.02, depth, z, gap)
        if x - end > 0.22:
            vase = np.array([(0, 0), (0.04, 0), (0.06, 0.35), (0.03, 0.75), (0.035, 0.85), (0, 0.85)]) * [1, 0.75 * gap]
            pen.turned(vase, "clay" if pen.rng.random() < 0.5 else "ceramic", at=(end + 0.10, 0.0, z), segments=12)


def media_bench(pen: Pen, size: Size) -> None:
    """Draw a low bench with doors and a television on it."""
    width, depth, height = size
    x, y, top = width / 2, depth / 2, 0.48
    pen.box((-x + 0.05, -y + 0.05, 0.0), (x - 0.05, y - 0.06, 0.09), "dark metal")
    pen.box((-x, -y, 0.08), (x, y - 0.02, top), "shelf wood")
    for k in range(3):
        cupboard_front(pen, -x + k * width / 3, -x + (k + 1) * width / 3, y - 0.02, 0.09, top - 0.03, "fronts")
    wide = min(width - 0.2, 1.25) / 2
    pen.box((-0.2, -0.07, top), (0.2, 0.12, top + 0.03), "dark metal")
    pen.box((-0.05, -0.03, top + 0.03), (0.05, 0.03, top + 0.1), "dark metal")
    pen.box((-wide, -0.03, top + 0.08), (wide, 0.015, height), "dark metal")
    pen.panel((-wide + 0.02, 0.012, top + 0.10), (wide - 0.02, 0.02, height - 0.02), "screen")


def wardrobe(pen: Pen, size: Size) -> None:
    """Draw a tall cupboard with doors."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.box((-x + 0.03, -y + 0.03, 0.0), (x - 0.03, y - 0.06, 0.08), "dark metal")
    pen.box((-x, -y, 0.07), (x, y - 0.022, height), "shelf wood")
    count = max(2, round(width / 0.5))
    for k in range(count):
        a, b = -x + k * width / count, -x + (k + 1) * width / count
        cupboard_front(pen, a, b, y - 0.022, 0.09, height - 0.02, "fronts", handle="left" if k % 2 else "right")


def dresser(pen: Pen, size: Size) -> None:
    """Draw a chest of drawers with a vase and a box on top."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.legs(width - 0.04, depth - 0.08, 0.12, "light wood")
    pen.box((-x, -y, 0.10), (x, y - 0.02, height), "light wood")
    for row in np.linspace(0.12, height - 0.03, 4)[:-1]:
        high = (height - 0.15) / 3
        cupboard_front(pen, -x + 0.01, 0, y - 0.02, row, row + high, "fronts")
        cupboard_front(pen, 0, x - 0.01, y - 0.02, row, row + high, "fronts")
    vase = [(0, 0), (0.06, 0), (0.09, 0.1), (0.05, 0.2), (0.03, 0.26), (0.045, 0.3), (0, 0.3)]
    pen.turned(vase, "ceramic", at=(pen.rng.uniform(-0.35, -0.15) * width, 0, height))
    pen.soft((0.12 * width, -0.1, height), (0.12 * width + 0.26, 0.08, height + 0.14), "cushion", radius=0.02)


def nightstand(pen: Pen, size: Size) -> None:
    """Draw a bedside cupboard with a lamp."""
    width, depth, _ = size
    x, y, top = width / 2, depth / 2, 0.5
    pen.legs(width - 0.02, depth - 0.04, 0.14, "light wood", thick=0.04)
    pen.box((-x, -y, 0.13), (x, y - 0.02, top), "light wood")
    cupboard_front(pen, -x + 0.01, x - 0.01, y - 0.02, 0.15, 0.31, "fronts")
    cupboard_front(pen, -x + 0.01, x - 0.01, y - 0.02, 0.31, top - 0.02, "fronts")
    pen.turned([(0, 0), (0.07, 0), (0.07, 0.02), (0.02, 0.04), (0.016, 0.2), (0, 0.2)], "brass", at=(0, -0.02, top))
    pen.round(
        0, -0.02, top + 0.2, top + 0.4, pen.materials.glowing((1.0, 0.93, 0.80), 1.0), radius=0.13, top_radius=0.09
    )


def desk(pen: Pen, size: Size) -> None:
    """Draw a desk with drawers, a monitor, a keyboard and a few books."""
    width, depth, height = size
    x, y, top = width / 2, depth / 2, 0.74
    pen.box((-x, -y, top - 0.03), (x, y, top), "table wood")
    pen.post(-x + 0.05, -y + 0.05, 0, top - 0.03, "table wood", width=0.05)
    pen.post(-x + 0.05, y - 0.05, 0, top - 0.03, "table wood", width=0.05)
    pen.box((x - 0.42, -y + 0.03, 0.0), (x - 0.02, y - 0.05, top - 0.03), "table wood")
    for row in (0.05, 0.27, 0.49):
        cupboard_front(pen, x - 0.42, x - 0.02, y - 0.05, row, row + 0.21, "fronts")
    pen.box((-0.32, -y + 0.10, top), (-0.08, -y + 0.28, top + 0.03), "dark metal")
    pen.box((-0.225, -y + 0.13, top + 0.03), (-0.175, -y + 0.18, top + 0.2), "dark metal")
    pen.box((-0.50, -y + 0.17, top + 0.11), (0.10, -y + 0.205, height), "dark metal")
    pen.panel((-0.49, -y + 0.202, top + 0.12), (0.09, -y + 0.21, height - 0.01), "screen")
    pen.box((-0.42, 0.02, top), (0.0, 0.17, top + 0.025), "dark metal")
    _books(pen, x - 0.36, x - 0.08, -y + 0.05, 0.24, top, 0.3)


def fridge(pen: Pen, size: Size) -> None:
    """Draw a fridge and freezer with two doors."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.box((-x + 0.02, -y, 0.0), (x - 0.02, y - 0.08, 0.06), "dark metal")
    pen.soft((-x, -y, 0.05), (x, y - 0.055, height), "steel", radius=0.02)
    for z0, z1 in ((0.07, 0.68), (0.69, height - 0.01)):
        pen.soft((-x + 0.003, y - 0.06, z0), (x - 0.003, y - 0.012, z1), "steel", radius=0.02)
        pen.box((x - 0.09, y - 0.02, z1 - 0.30), (x - 0.06, y + 0.02, z1 - 0.06), "dark metal")
