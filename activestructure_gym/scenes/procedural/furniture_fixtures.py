"""Draw kitchen and bathroom fittings. Sizes are (width, depth, height) in metres."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural.furniture_pen import Pen
from activestructure_gym.scenes.procedural.furniture_storage import Size, cupboard_front
from activestructure_gym.scenes.procedural.mesh_shapes import lathe, lying

MODULE = 0.6  # metres, width of a kitchen unit (EN 1116)


def kitchen_run(pen: Pen, size: Size) -> None:
    """Draw base units with worktop, sink, hob and oven."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    count = round(width / MODULE)
    pen.box((-x, -y, 0.0), (x, y - 0.07, 0.10), "dark metal")
    pen.box((-x, -y, 0.10), (x, y - 0.04, height - 0.04), "white")
    sink, hob = (0, count - 2) if count > 2 else (0, count - 1)
    for k in range(count):
        a, b = -x + k * MODULE, -x + (k + 1) * MODULE
        if k == hob:
            pen.panel((a + 0.004, y - 0.041, 0.12), (b - 0.004, y - 0.02, height - 0.05), "oven")
            pen.box((a + 0.1, y - 0.025, 0.66), (b - 0.1, y + 0.0, 0.685), "steel")
        elif k % 2:
            for z0, z1 in ((0.11, 0.36), (0.36, 0.61), (0.61, height - 0.045)):
                cupboard_front(pen, a, b, y - 0.04, z0, z1, "fronts")
        else:
            cupboard_front(pen, a, b, y - 0.04, 0.11, height - 0.045, "fronts")
    pen.box((-x, -y, height - 0.04), (x, y, height), "worktop")
    s = -x + (sink + 0.5) * MODULE
    pen.box((s - 0.24, -0.19, height), (s + 0.24, 0.19, height + 0.008), "steel")
    pen.box((s - 0.20, -0.15, height + 0.006), (s + 0.20, 0.15, height + 0.0085), "dark metal")
    pen.round(s, -0.23, height, height + 0.24, "steel", radius=0.016)
    pen.box((s - 0.014, -0.24, height + 0.22), (s + 0.014, -0.06, height + 0.25), "steel")
    h = -x + (hob + 0.5) * MODULE
    pen.box((h - 0.28, -0.25, height), (h + 0.28, 0.25, height + 0.008), "dark metal")
    for i in (-1, 1):
        for j in (-1, 1):
            pen.round(h + 0.13 * i, 0.12 * j, height + 0.006, height + 0.012, "steel", radius=0.08, segments=16)
    pot = [(0, 0), (0.09, 0), (0.1, 0.02), (0.1, 0.12), (0.06, 0.14), (0.015, 0.145), (0.02, 0.17), (0, 0.17)]
    pen.turned(pot, "steel", at=(h - 0.13, -0.12, height + 0.012))
    if count > 2:
        middle = -x + 1.5 * MODULE
        pen.box((middle - 0.15, -y + 0.08, height), (middle + 0.15, -y + 0.26, height + 0.2), "accent paint")
        pen.round(middle + 0.23, -y + 0.16, height, height + 0.22, "ceramic", radius=0.05)


def wall_units(pen: Pen, size: Size) -> None:
    """Draw wall cupboards with their lower edge at z = 0; the placement of the piece lifts them."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    count = round(width / MODULE)
    pen.box((-x, -y, 0.0), (x, y - 0.022, height), "white")
    for k in range(count):
        cupboard_front(pen, -x + k * MODULE, -x + (k + 1) * MODULE, y - 0.022, 0.0, height, "fronts", handle="")
        pen.box((-x + k * MODULE + 0.2, y - 0.01, 0.02), (-x + k * MODULE + 0.4, y + 0.02, 0.045), "steel")


def splashback(pen: Pen, size: Size) -> None:
    """Draw tiles on the wall above a worktop."""
    width, depth, height = size
    pen.box((-width / 2, -depth / 2, 0.0), (width / 2, depth / 2, height), "backsplash")


def bathtub(pen: Pen, size: Size) -> None:
    """Draw a bathtub: a panelled block with a rim and a hollow."""
    width, depth, height = size
    x, y, rim, floor = width / 2, depth / 2, 0.07, 0.2
    pen.box((-x + 0.01, -y + 0.01, 0.0), (x - 0.01, y - 0.01, floor), "ceramic")
    pen.box((-x + 0.012, y - rim, floor), (x - 0.012, y - 0.012, height - 0.03), "wall bath")
    pen.box((-x + 0.012, -y + 0.012, floor), (x - 0.012, -y + rim, height - 0.03), "wall bath")
    pen.box((-x + 0.012, -y + rim, floor), (-x + rim, y - rim, height - 0.03), "ceramic")
    pen.box((x - rim, -y + rim, floor), (x - 0.012, y - rim, height - 0.03), "ceramic")
    for sign in (-1, 1):
        a, b = sorted((sign * y, sign * (y - rim - 0.02)))
        pen.soft((-x, a, height - 0.05), (x, b, height), "ceramic", radius=0.02)
    for sign in (-1, 1):
        a, b = sorted((sign * x, sign * (x - rim - 0.04)))
        pen.soft((a, -y + 0.01, height - 0.05), (b, y - 0.01, height - 0.001), "ceramic", radius=0.02)
    pen.round(-x + 0.25, -y + 0.05, height, height + 0.12, "steel", radius=0.02)
    pen.box((-x + 0.235, -y + 0.05, height + 0.09), (-x + 0.265, -y + 0.2, height + 0.12), "steel")


def toilet(pen: Pen, size: Size) -> None:
    """Draw a toilet with cistern."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.soft((-x, -y, 0.36), (x, -y + 0.18, height), "ceramic", radius=0.03)
    pen.box((-0.10, -y + 0.02, 0.0), (0.10, -y + 0.3, 0.37), "ceramic")
    with pen.builder.placed((0, y - 0.24, 0)):
        bowl = [(0, 0), (0.12, 0), (0.11, 0.12), (0.15, 0.28), (0.185, 0.37), (0.185, 0.39), (0, 0.39)]
        pen.turned(bowl, "ceramic", segments=20)
        pen.turned([(0, 0.385), (0.19, 0.385), (0.19, 0.42), (0.17, 0.43), (0, 0.43)], "white", segments=20)


def vanity(pen: Pen, size: Size) -> None:
    """Draw a wash basin on a cupboard with a mirror above; the height in ``size`` is the top of the mirror."""
    width, depth, top = size
    x, y, height = width / 2, depth / 2, 0.84
    pen.box((-x, -y, 0.2), (x, y - 0.02, height - 0.04), "light wood")
    cupboard_front(pen, -x + 0.01, 0, y - 0.02, 0.22, height - 0.05, "fronts", handle="right")
    cupboard_front(pen, 0, x - 0.01, y - 0.02, 0.22, height - 0.05, "fronts", handle="left")
    pen.box((-x, -y, height - 0.04), (x, y, height), "ceramic")
    basin = [(0, 0), (0.12, 0), (0.19, 0.1), (0.20, 0.12), (0.175, 0.12), (0.10, 0.035), (0, 0.03)]
    pen.turned(basin, "ceramic", at=(0, 0.02, height), segments=20)
    pen.round(0, -y + 0.06, height, height + 0.2, "steel", radius=0.016)
    pen.box((-0.014, -y + 0.05, height + 0.18), (0.014, -y + 0.2, height + 0.21), "steel")
    pen.box((-0.38 * width, -y, 1.15), (0.38 * width, -y + 0.025, top), "light wood")
    pen.box((-0.38 * width + 0.03, -y + 0.02, 1.18), (0.38 * width - 0.03, -y + 0.028, top - 0.03), "mirror")


def washing_machine(pen: Pen, size: Size) -> None:
    """Draw a front-loading washing machine."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.soft((-x, -y, 0.02), (x, y - 0.03, height), "white", radius=0.015)
    pen.box((-x + 0.03, y - 0.032, height - 0.13), (x - 0.03, y - 0.02, height - 0.03), "steel")
    with pen.builder.placed((0, y - 0.04, 0.42)):
        ring = [(0, 0), (0.20, 0), (0.20, 0.03), (0.17, 0.045), (0.13, 0.03), (0, 0.03)]
        pen.add(lying(lathe(np.array(ring), segments=24)), "steel")
        pane = [(0, 0.0), (0.128, 0.0), (0.128, 0.034), (0, 0.045)]
        pen.add(lying(lathe(np.array(pane), segments=24)), "dark metal")


def towel_rail(pen: Pen, size: Size) -> None:
    """Draw a heated wall rail with a towel over it."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    for sign in (-1, 1):
        pen.box((sign * x - 0.015, -y, 0.0), (sign * x + 0.015, -y + 0.05, height), "steel")
    for k in range(7):
        z = 0.05 + k * (height - 0.1) / 6
        pen.box((-x, -y + 0.01, z - 0.0125), (x, -y + 0.035, z + 0.0125), "steel")
    pen.soft((-0.75 * x, -y + 0.005, 0.35 * height), (0.75 * x, y, 0.93 * height), "cushion", radius=0.02)
