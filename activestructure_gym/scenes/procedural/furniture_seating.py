"""Draw seats and beds, and the tables in front of them. Sizes are (width, depth, height) in metres."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural.furniture_pen import Pen

Size = tuple[float, float, float]


def _upholstered(pen: Pen, size: Size, *, seats: int, role: str) -> None:
    width, depth, height = size
    x, y = width / 2, depth / 2
    arm = 0.17
    for sign in (-1, 1):
        for back in (-1, 1):
            pen.post(sign * (x - 0.08), back * (y - 0.1), 0.0, 0.12, "dark wood", width=0.05)
    pen.soft((-x + 0.02, -y + 0.02, 0.10), (x - 0.02, y - 0.03, 0.30), role, radius=0.04)
    pen.soft((-x + arm / 2, -y, 0.12), (x - arm / 2, -y + 0.2, height - 0.04), role, radius=0.07)
    for sign in (-1, 1):
        a, b = sorted((sign * x, sign * (x - arm)))
        pen.soft((a, -y + 0.03, 0.11), (b, y, 0.60), role, radius=0.07)
    room = (width - 2 * arm) / seats
    for seat in range(seats):
        a = -x + arm + seat * room
        pen.soft((a + 0.004, -y + 0.18, 0.28), (a + room - 0.004, y - 0.01, 0.45), role, radius=0.05, puff=0.025)
        pen.soft((a + 0.01, -y + 0.14, 0.43), (a + room - 0.01, -y + 0.34, height), role, radius=0.07, puff=0.02)


def sofa(pen: Pen, size: Size) -> None:
    """Draw a sofa with two or three seats and loose cushions."""
    width, depth, _ = size
    _upholstered(pen, size, seats=3 if width > 1.9 else 2, role="sofa")
    for sign in (-1, 1):
        tilt = sign * pen.rng.uniform(0.15, 0.5)
        with pen.builder.placed((sign * (width / 2 - 0.40), -depth / 2 + 0.42, 0.45), tilt):
            pen.soft((-0.2, -0.07, 0.0), (0.2, 0.05, 0.38), "cushion", radius=0.05, puff=0.03)


def armchair(pen: Pen, size: Size) -> None:
    """Draw a single upholstered seat."""
    _upholstered(pen, size, seats=1, role="textile")


def bed(pen: Pen, size: Size) -> None:
    """Draw a bed with headboard, mattress, pillows and a bedspread."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    pen.box((-x, -y, 0.0), (x, -y + 0.07, height), "light wood")
    pen.box((-x + 0.02, -y + 0.07, 0.08), (x - 0.02, y, 0.30), "light wood")
    pen.legs(width - 0.1, depth - 0.2, 0.09, "light wood", thick=0.07)
    pen.soft((-x + 0.03, -y + 0.08, 0.29), (x - 0.03, y - 0.03, 0.50), "linen", radius=0.06)
    spread = -y + 0.62
    pen.soft((-x - 0.005, spread, 0.24), (x + 0.005, y + 0.005, 0.56), "bedspread", radius=0.06)
    pen.soft((-x + 0.01, spread - 0.02, 0.50), (x - 0.01, spread + 0.22, 0.585), "linen", radius=0.035)
    places = (-0.25, 0.25) if width > 1.2 else (0.0,)
    for place in places:
        with pen.builder.placed((place * width, -y + 0.33, 0.5), pen.rng.uniform(-0.06, 0.06)):
            half = 0.21 * width if len(places) == 2 else 0.36 * width
            pen.soft((-half, -0.21, 0.0), (half, 0.21, 0.13), "linen", radius=0.06, puff=0.03)
    if len(places) == 2 and pen.rng.random() < 0.7:
        for place in places:
            with pen.builder.placed((place * width * 0.8, -y + 0.50, 0.52), pen.rng.uniform(-0.1, 0.1)):
                pen.soft((-0.22, -0.09, 0.0), (0.22, 0.05, 0.33), "cushion", radius=0.05, puff=0.03)


def chair(pen: Pen, size: Size) -> None:
    """Draw a kitchen chair: seat at 0.45 m, back with three slats."""
    width, depth, height = size
    x, y = width / 2, depth / 2
    role = "dark wood" if pen.materials["table wood"] == pen.materials["dark wood"] else "light wood"
    for sign in (-1, 1):
        pen.post(sign * (x - 0.02), y - 0.02, 0.0, 0.44, role)
        pen.post(sign * (x - 0.02), -y + 0.02, 0.0, height, role)
    pen.box((-x, -y + 0.03, 0.36), (x, y, 0.43), role)
    pen.soft((-x + 0.005, -y + 0.02, 0.42), (x - 0.005, y + 0.01, 0.475), "textile", radius=0.02)
    for z in (0.60, 0.72, 0.84):
        pen.box((-x + 0.03, -y + 0.005, z - 0.03), (x - 0.03, -y + 0.035, z + 0.03), role)


def office_chair(pen: Pen, size: Size) -> None:
    """Draw a swivel chair: five feet, a column, seat and back."""
    _, depth, height = size
    pen.round(0, 0, 0.04, 0.42, "dark metal", radius=0.035)
    for spoke in range(5):
        with pen.builder.placed((0, 0, 0), 2 * np.pi * spoke / 5):
            pen.box((-0.025, 0.02, 0.05), (0.025, 0.28, 0.09), "dark metal")
            pen.box((-0.03, 0.24, 0.0), (0.03, 0.30, 0.06), "dark metal")
    pen.soft((-0.25, -0.22, 0.42), (0.25, 0.26, 0.51), "sofa", radius=0.04, puff=0.01)
    pen.box((-0.04, -0.27, 0.45), (0.04, -0.23, 0.70), "dark metal")
    pen.soft((-0.22, -depth / 2, 0.60), (0.22, -depth / 2 + 0.08, height), "sofa", radius=0.04, puff=0.01)


def pouf(pen: Pen, size: Size) -> None:
    """Draw a round upholstered stool."""
    radius, height = size[0] / 2, size[2]
    profile = [(0, 0), (0.85 * radius, 0), (radius, 0.2 * height), (radius, 0.8 * height), (0.8 * radius, height)]
    pen.turned([*profile, (0, 1.03 * height)], "cushion", segments=20)


def _top(pen: Pen, size: Size, role: str) -> None:
    width, depth, height = size
    pen.box((-width / 2, -depth / 2, height - 0.035), (width / 2, depth / 2, height), role)


def coffee_table(pen: Pen, size: Size) -> None:
    """Draw a low table with a shelf, a bowl and a few books."""
    width, depth, height = size
    _top(pen, size, "table wood")
    pen.legs(width - 0.06, depth - 0.06, height - 0.035, "table wood")
    pen.box((-width / 2 + 0.06, -depth / 2 + 0.06, 0.14), (width / 2 - 0.06, depth / 2 - 0.06, 0.165), "table wood")
    bowl = [(0, 0), (0.05, 0), (0.12, 0.06), (0.10, 0.06), (0.04, 0.025), (0, 0.025)]
    pen.turned(bowl, "ceramic", at=(0.22 * width, pen.rng.uniform(-0.08, 0.08), height))
    with pen.builder.placed((-0.22 * width, 0, height), pen.rng.uniform(-0.4, 0.4)):
        tone = pen.materials.scheme.accent
        pen.box((-0.14, -0.10, 0.0), (0.14, 0.10, 0.03), pen.materials.tinted("linen", tone))
        pen.box((-0.12, -0.09, 0.03), (0.11, 0.08, 0.055), pen.materials.tinted("linen", pen.materials.scheme.cushion))


def dining_table(pen: Pen, size: Size) -> None:
    """Draw a table with an apron and a vase or a fruit bowl."""
    width, depth, height = size
    _top(pen, size, "table wood")
    pen.legs(width - 0.06, depth - 0.06, height - 0.035, "table wood", thick=0.06)
    pen.box(
        (-width / 2 + 0.08, -depth / 2 + 0.08, height - 0.11),
        (width / 2 - 0.08, depth / 2 - 0.08, height - 0.035),
        "table wood",
    )
    if pen.rng.random() < 0.5:
        vase = [(0, 0), (0.05, 0), (0.075, 0.08), (0.06, 0.16), (0.032, 0.21), (0.042, 0.25), (0, 0.25)]
        pen.turned(vase, "clay", at=(0, 0, height))
    else:
        bowl = [(0, 0), (0.06, 0), (0.15, 0.07), (0.13, 0.07), (0.05, 0.025), (0, 0.025)]
        pen.turned(bowl, "ceramic", at=(0, 0, height))
        for angle in range(4):
            x, y = 0.055 * np.cos(1.6 * angle), 0.055 * np.sin(1.6 * angle)
            fruit = [(0, 0), (0.03, 0.01), (0.04, 0.04), (0.03, 0.07), (0, 0.08)]
            pen.turned(fruit, "clay" if angle % 2 else "brass", at=(x, y, height + 0.03), segments=10)
