"""Draw lamps, plants, rugs, pictures, curtains, radiators. Sizes are (width, depth, height) in metres."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural import mesh_shapes
from activestructure_gym.scenes.procedural.furniture_pen import Pen
from activestructure_gym.scenes.procedural.furniture_storage import Size

PICTURES = 6  # number of different paintings in an apartment
SHADE = (1.0, 0.94, 0.82)  # colour of a lit lamp shade


def floor_lamp(pen: Pen, size: Size) -> None:
    """Draw a standing lamp with a shade."""
    height = size[2]
    pen.turned([(0, 0), (0.14, 0), (0.14, 0.015), (0.03, 0.03), (0, 0.03)], "dark metal", segments=20)
    pen.round(0, 0, 0.02, height - 0.2, "dark metal", radius=0.018)
    shade = pen.materials.glowing(SHADE, 1.0)
    pen.round(0, 0, height - 0.28, height, shade, radius=0.2, top_radius=0.14, segments=20)


def pendant(pen: Pen, size: Size) -> None:
    """Draw a lamp hanging from the ceiling, from its lower rim (z = 0) up to the ceiling."""
    radius, height = size[0] / 2, size[2]
    shade = pen.materials.glowing(SHADE, 1.05)
    pen.turned([(0, 0.02), (radius, 0.0), (0.55 * radius, 0.2), (0.1, 0.24), (0, 0.24)], shade, segments=20)
    pen.round(0, 0, 0.23, height - 0.002, "dark metal", radius=0.0125, segments=6)
    pen.round(0, 0, height - 0.03, height - 0.001, "dark metal", radius=0.05)


def plant(pen: Pen, size: Size) -> None:
    """Draw a rubber plant in a pot: a stem and thick leaves."""
    width, _, height = size
    tub = 0.30
    pot = [
        (0, 0),
        (0.11, 0),
        (0.12, 0.02),
        (0.16, tub - 0.02),
        (0.165, tub),
        (0.14, tub),
        (0.14, tub - 0.03),
        (0, tub - 0.03),
    ]
    pen.turned(pot, "clay" if pen.rng.random() < 0.5 else "ceramic", segments=20)
    pen.turned([(0, tub - 0.06), (0.14, tub - 0.06), (0.14, tub - 0.025), (0, tub - 0.02)], "soil")
    pen.round(0, 0, tub - 0.03, height - 0.12, "stem", radius=0.018, top_radius=0.0135, segments=8)
    count = int(22 * height)
    for k in range(count):
        share = k / (count - 1)
        z = tub + 0.10 + (height - tub - 0.22) * share
        reach = (width / 2) * (1.0 - 0.45 * share) * pen.rng.uniform(0.85, 1.0)
        with pen.builder.placed((0, 0, z), 2.4 * k + pen.rng.uniform(-0.2, 0.2)):  # 2.4 rad: golden angle
            drop = pen.rng.uniform(-0.16, 0.05) if share > 0.5 else pen.rng.uniform(-0.10, 0.10)
            tone = pen.rng.uniform(0.8, 1.1)
            green = pen.materials.tinted("foliage", (tone, tone, 0.9 * tone))
            pen.add(mesh_shapes.leaf(reach, 0.42 * reach + 0.03, 0.025, drop), green)


def rug(pen: Pen, size: Size) -> None:
    """Draw a carpet on the floor."""
    width, depth, height = size
    pen.panel((-width / 2, -depth / 2, 0.0), (width / 2, depth / 2, height), pen.materials["rug"])


def mat(pen: Pen, size: Size) -> None:
    """Draw a bath mat."""
    width, depth, height = size
    pen.box((-width / 2, -depth / 2, 0.0), (width / 2, depth / 2, height), "mat")


def picture(pen: Pen, size: Size) -> None:
    """Draw a framed painting with its lower edge at z = 0."""
    width, depth, height = size
    x, y, rim = width / 2, depth / 2, 0.035
    frame = ("dark wood", "light wood", "dark metal")[pen.rng.integers(3)]
    pen.box((-x, -y, 0.0), (x, y - 0.008, height), frame)
    pen.box((-x + rim, -y + 0.002, rim), (x - rim, y - 0.006, height - rim), "white")
    inner = rim + 0.09 * min(width, height)
    role = f"picture {pen.seed % PICTURES}"
    pen.panel((-x + inner, -y + 0.004, inner), (x - inner, y - 0.002, height - inner), role)


def curtain(pen: Pen, size: Size) -> None:
    """Draw a pleated, closed curtain, 4 cm thick."""
    width, depth, height = size
    count = max(9, round(width / 0.02))
    x = np.linspace(-width / 2, width / 2, count)
    waves = max(2, round(width / 0.11))
    middle = (depth / 2 - 0.022) * np.sin(2 * np.pi * waves * (x / width + 0.5) + pen.rng.random())
    outline = np.stack([np.stack([x, middle - 0.02], 1), np.stack([x, middle + 0.02], 1)], axis=1)
    pen.add(mesh_shapes.extrusion(outline, 0.0, height, max_edge=0.2), "curtain")


def curtain_rod(pen: Pen, size: Size) -> None:
    """Draw a rod with knobs at its ends."""
    width, _, _ = size
    pen.box((-width / 2, -0.0125, 0.0), (width / 2, 0.0125, 0.025), "dark metal")
    for sign in (-1, 1):
        pen.box((sign * width / 2 - 0.02, -0.02, -0.008), (sign * width / 2 + 0.02, 0.02, 0.033), "dark metal")


def radiator(pen: Pen, size: Size) -> None:
    """Draw a panel radiator with ribs, 10 cm above the floor."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.box((-x, -y + 0.02, 0.10), (x, y - 0.015, height), "white")
    count = int(width / 0.06)
    for k in range(count):
        rib = -x + (k + 0.5) * width / count
        pen.box((rib - 0.018, y - 0.016, 0.12), (rib + 0.018, y, height - 0.02), "white", max_edge=0.6)
    pen.box((-x + 0.05, -y, 0.2), (-x + 0.1, -y + 0.02, 0.3), "steel")
    pen.box((x - 0.1, -y, 0.2), (x - 0.05, -y + 0.02, 0.3), "steel")


def window_frame(pen: Pen, size: Size) -> None:
    """Draw a frame with a mullion and its lower edge at z = 0."""
    width, depth, height = size
    x, y, bar = width / 2, depth / 2, 0.05
    pen.box((-x, -y, 0.0), (-x + bar, y, height), "trim")
    pen.box((x - bar, -y, 0.0), (x, y, height), "trim")
    pen.box((-x + bar, -y, 0.0), (x - bar, y, bar), "trim")
    pen.box((-x + bar, -y, height - bar), (x - bar, y, height), "trim")
    if width > 0.9:
        pen.box((-0.03, -y + 0.002, bar), (0.03, y - 0.002, height - bar), "trim")


def front_door(pen: Pen, size: Size) -> None:
    """Draw the closed entrance door: leaf with panels, frame and handle."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.box((-x, -y, 0.0), (-x + 0.07, y, height), "trim")
    pen.box((x - 0.07, -y, 0.0), (x, y, height), "trim")
    pen.box((-x + 0.07, -y, height - 0.07), (x - 0.07, y, height), "trim")
    pen.box((-x + 0.07, -y, 0.0), (x - 0.07, y - 0.02, height - 0.07), "door")
    for z0, z1 in ((0.15, 0.95), (1.1, height - 0.2)):
        pen.box((-x + 0.17, y - 0.022, z0), (x - 0.17, y - 0.014, z1), "door")
    pen.box((x - 0.15, y - 0.021, 1.0), (x - 0.125, y + 0.03, 1.025), "steel")
    pen.box((x - 0.25, y + 0.012, 1.0), (x - 0.125, y + 0.037, 1.025), "steel")
