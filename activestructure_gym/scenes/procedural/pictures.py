"""Paint images that cover a surface once: paintings, the view from a window, a screen, the front of an oven."""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.procedural.textures import Color, finish, noise, pixel_grid


def landscape(rng: np.random.Generator, *, size: int = 256) -> np.ndarray:
    """Paint hills in front of an evening sky."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    sky = np.array([0.86, 0.72, 0.56]) * (v / 0.6)[..., None] + np.array([0.42, 0.56, 0.70]) * (1 - v / 0.6)[..., None]
    image = np.clip(sky, 0, 1)
    for depth in range(4):
        waves = sum(rng.normal(0, 0.05 / k) * np.sin(2 * np.pi * (k * u[0] + rng.random())) for k in range(1, 5))
        ridge = 0.45 + 0.13 * depth + waves
        tone = np.array([0.28, 0.36, 0.30]) * (1.25 - 0.2 * depth) + rng.normal(0, 0.03, 3)
        image = np.where((v > ridge[None, :])[..., None], tone, image)
    return finish(image * (1 + 0.04 * noise(rng, shape, falloff=1.2, smallest=2)[..., None]))


def abstract(rng: np.random.Generator, *, size: int = 256) -> np.ndarray:
    """Paint flat coloured cells with dark lines between them; a cell contains the pixels nearest to a random point."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    points = rng.random((14, 2))
    distance = np.sort(np.hypot(u[..., None] - points[:, 0], v[..., None] - points[:, 1]), axis=-1)
    nearest = np.argmin(np.hypot(u[..., None] - points[:, 0], v[..., None] - points[:, 1]), axis=-1)
    base = np.array(
        [[0.80, 0.74, 0.62], [0.63, 0.40, 0.30], [0.28, 0.38, 0.45], [0.76, 0.60, 0.34], [0.45, 0.52, 0.42]]
    )
    palette = base[rng.integers(0, len(base), len(points))] * rng.uniform(0.85, 1.1, (len(points), 1))
    line = np.clip((distance[..., 1] - distance[..., 0]) / 0.015, 0.25, 1.0)
    return finish(palette[nearest] * line[..., None] * (1 + 0.03 * noise(rng, shape, smallest=2)[..., None]))


def still_life(rng: np.random.Generator, *, size: int = 256) -> np.ndarray:
    """Paint overlapping discs on a dim ground."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    image = np.array([0.72, 0.68, 0.60]) * (1.05 - 0.3 * v)[..., None]
    for _ in range(7):
        x, y, radius = rng.uniform(0.15, 0.85), rng.uniform(0.35, 0.8), rng.uniform(0.06, 0.17)
        color = np.array([0.75, 0.45, 0.25]) * rng.uniform(0.5, 1.1) + rng.normal(0, 0.08, 3)
        inside = np.hypot(u - x, v - y) < radius
        shade = 1.1 - 0.7 * np.hypot(u - x + radius / 3, v - y + radius / 3) / radius
        image = np.where(inside[..., None], np.clip(color * shade[..., None], 0, 1), image)
    return finish(image * (1 + 0.03 * noise(rng, shape, smallest=2)[..., None]))


def street(rng: np.random.Generator, *, size: int = 256) -> np.ndarray:
    """Paint the view from a window: bright sky, houses across the street, trees."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    cloud = np.clip(noise(rng, shape, falloff=1.9, stretch=0.5, smallest=6), -1, 2)
    image = np.array([0.78, 0.88, 0.97]) + 0.04 * cloud[..., None] + 0.06 * (v - 0.5)[..., None]
    x = 0.0
    while x < 1.0:
        width, top = rng.uniform(0.16, 0.32), rng.uniform(0.38, 0.62)
        tone = np.array([0.80, 0.76, 0.70]) * rng.uniform(0.8, 1.05) + rng.normal(0, 0.02, 3)
        house = (u >= x) & (u < x + width) & (v > top)
        image = np.where(house[..., None], tone, image)
        pane = (np.abs(((u - x) * 18) % 1 - 0.5) < 0.24) & (np.abs(((v - top) * 11) % 1 - 0.55) < 0.27)
        image = np.where((house & pane & (v > top + 0.03))[..., None], tone * 0.72, image)
        x += width
    crown = 0.80 + 0.05 * np.sin(2 * np.pi * (2 * u + rng.random())) + 0.03 * noise(rng, shape, falloff=1.4, smallest=5)
    tree = np.array([0.52, 0.62, 0.44]) * (1 + 0.10 * noise(rng, shape, falloff=1.0, smallest=4))[..., None]
    return finish(np.where((v > crown)[..., None], tree, image))


def screen(rng: np.random.Generator, *, size: int = 128) -> np.ndarray:
    """Paint a dark television or monitor with a faint reflection of the room."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    reflection = np.exp(-(((u - rng.uniform(0.2, 0.8)) / 0.18) ** 2 + ((v - 0.4) / 0.3) ** 2))
    return finish(np.array([0.07, 0.075, 0.09]) + reflection[..., None] * np.array([0.10, 0.11, 0.13]))


def appliance(rng: np.random.Generator, *, color: Color, size: int = 128) -> np.ndarray:
    """Paint the front of an oven or washing machine: a dark window in a plain face with a row of knobs."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    image = np.broadcast_to(np.array(color), (*shape, 3)).copy()
    glass = (np.abs(u - 0.5) < 0.38) & (np.abs(v - 0.60) < 0.26)
    image[glass] = 0.13 + 0.08 * (1 - v[glass])[:, None]
    for x in rng.permutation(np.linspace(0.2, 0.8, 4)):
        image[np.hypot(u - x, v - 0.13) < 0.045] = 0.35
    return finish(image)
