"""Paint tileable textures from noise: plaster, wood, tiles, cloth, rugs, stone.

Noise is generated in the frequency domain, with random phases and amplitudes by a power law. It tiles and costs one
FFT. Every function takes its own random generator, so a texture does not depend on textures painted earlier.
"""

from __future__ import annotations

import numpy as np

# Factor on the contrast of all patterns. With it, renderings have about as much fine detail as images of real rooms:
# the PSNR between a 320x240 image and its blur with sigma 1.5 px is 29 to 32 dB in both.
CONTRAST = 0.75

Color = tuple[float, float, float]  # sRGB, 0..1


def noise(
    rng: np.random.Generator,
    shape: tuple[int, int],
    *,
    falloff: float = 1.6,  # amplitude ~ frequency^-falloff; 1 = rough, 2 = cloudy
    stretch: float = 1.0,  # > 1: features are this many times longer along u
    smallest: float = 0.0,  # features below this many pixels are removed
) -> np.ndarray:  # [h, w] zero mean, unit deviation
    """Return tileable noise with a power-law spectrum."""
    rows = np.fft.fftfreq(shape[0])[:, None]
    columns = np.fft.rfftfreq(shape[1])[None, :] * stretch
    frequency = np.hypot(rows, columns)
    frequency[0, 0] = 1.0
    amplitude = frequency**-falloff
    amplitude[0, 0] = 0.0
    if smallest > 0:
        amplitude *= np.exp(-((frequency * smallest) ** 2))
    spectrum = amplitude * np.exp(2j * np.pi * rng.random(amplitude.shape))
    field = np.fft.irfft2(spectrum, s=shape)
    return field / max(float(field.std()), 1e-12)


def finish(image: np.ndarray) -> np.ndarray:
    """Return an image [h, w] or [h, w, 3] in 0..1 with contrast reduced by `CONTRAST`, as [h, w, 3] uint8."""
    image = np.atleast_3d(image)
    mean = np.array([image[..., k].mean() for k in range(image.shape[2])])
    image = np.clip(mean + CONTRAST * (image - mean), 0.0, 1.0)
    return np.ascontiguousarray(np.broadcast_to(np.round(255 * image).astype(np.uint8), (*image.shape[:2], 3)))


def pixel_grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the texture coordinates u (across) and v (down) of the pixel centres, [h, w] each in 0..1."""
    v, u = np.meshgrid((np.arange(shape[0]) + 0.5) / shape[0], (np.arange(shape[1]) + 0.5) / shape[1], indexing="ij")
    return u, v


def plaster(rng: np.random.Generator, *, color: Color, stains: float = 0.011, size: int = 256) -> np.ndarray:
    """Paint the texture of a painted wall: soft stains, roller marks and a little grain."""
    shape = (size, size)
    value = stains * noise(rng, shape, falloff=1.8) + 0.012 * noise(rng, shape, falloff=0.6, smallest=3)
    return finish(np.array(color) * (1.0 + value[..., None]))


def wallpaper(rng: np.random.Generator, *, color: Color, second: Color, size: int = 256) -> np.ndarray:
    """Paint stripes, every other one with a row of diamonds."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    stripe = 0.5 + 0.5 * np.tanh(6 * np.sin(2 * np.pi * 4 * u))
    diamond = np.abs((4 * u) % 1 - 0.25) * 2 + np.abs((4 * v) % 1 - 0.5) < 0.22
    mix = np.clip(0.75 * stripe + 0.5 * diamond, 0, 1)[..., None]
    image = np.array(color) * (1 - mix) + np.array(second) * mix
    return finish(image * (1 + 0.02 * noise(rng, shape, falloff=1.4, smallest=3)[..., None]))


def planks(rng: np.random.Generator, *, color: Color, rows: int = 8, size: int = 512) -> np.ndarray:
    """Paint a wooden floor: boards along u in random lengths, grain, dark joints."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    row = np.floor(v * rows).astype(int)
    shift = rng.random(rows)
    board = np.floor((u + shift[row]) * 2).astype(int) % 2 + 2 * row
    tone = rng.normal(0, 0.07, 2 * rows)[board]
    hue = rng.normal(0, 0.02, 2 * rows)[board]
    grain = noise(rng, shape, falloff=1.3, stretch=14.0, smallest=2)
    # Every board shows another part of the grain.
    move = rng.integers(0, size, 2 * rows)
    grain = grain[np.arange(size)[:, None], (np.arange(size)[None, :] + move[board]) % size]
    along = 0.5 - np.abs((v * rows) % 1 - 0.5)  # 0 at the joint, in board widths
    across = (0.5 - np.abs(((u + shift[row]) * 2) % 1 - 0.5)) * rows / 2
    joint = np.exp(-((np.minimum(along, across) / 0.025) ** 2))
    value = 1.0 + tone + 0.05 * grain - 0.34 * joint
    image = np.array(color) * value[..., None]
    image[..., 0] += hue * 0.5
    return finish(image)


def wood(rng: np.random.Generator, *, color: Color, size: int = 256) -> np.ndarray:
    """Paint furniture wood: year rings cut along u, fine pores."""
    shape = (size, size)
    _, v = pixel_grid(shape)
    bend = noise(rng, shape, falloff=2.2, stretch=5.0)
    rings = np.sin(2 * np.pi * (5 * v + 0.55 * bend))
    pores = noise(rng, shape, falloff=0.9, stretch=16.0, smallest=2)
    value = 1.0 + 0.045 * rings + 0.032 * pores + 0.03 * noise(rng, shape, falloff=2.0)
    tint = np.array([0.6, 1.0, 1.2])  # darker rings are redder
    return finish(np.array(color) * (1.0 + (value[..., None] - 1.0) * tint))


def tiles(
    rng: np.random.Generator, *, color: Color, grout: Color, count: tuple[int, int] = (4, 4), size: int = 256
) -> np.ndarray:
    """Paint ceramic tiles with joints; each tile has its own tone."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    row, column = np.floor(v * count[0]).astype(int), np.floor(u * count[1]).astype(int)
    tone = rng.normal(0, 0.035, count)[row, column]
    edge = np.minimum(
        (0.5 - np.abs((v * count[0]) % 1 - 0.5)) / count[0], (0.5 - np.abs((u * count[1]) % 1 - 0.5)) / count[1]
    )
    joint = np.clip(1.4 - edge * size, 0, 1)[..., None]
    value = 1 + tone + 0.03 * noise(rng, shape, falloff=1.7, smallest=2)
    return finish(np.array(color) * value[..., None] * (1 - joint) + np.array(grout) * joint)


def fabric(
    rng: np.random.Generator, *, color: Color, size: int = 256, threads: int = 48, strength: float = 1.0
) -> np.ndarray:
    """Paint woven cloth: warp and weft, with wear."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    weave = np.sin(2 * np.pi * threads * u) * np.sin(2 * np.pi * threads * v)
    uneven = (
        noise(rng, shape, falloff=0.7, stretch=4.0, smallest=3)
        + noise(rng, shape[::-1], falloff=0.7, stretch=4.0, smallest=3).T
    )
    value = 1 + strength * (0.05 * weave + 0.03 * uneven + 0.025 * noise(rng, shape, falloff=1.8))
    return finish(np.array(color) * value[..., None])


def checked_fabric(rng: np.random.Generator, *, color: Color, second: Color, size: int = 256) -> np.ndarray:
    """Paint a bedspread with crossing bands."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    bands = 0.5 * (np.sin(2 * np.pi * 3 * u) > 0.2) + 0.5 * (np.sin(2 * np.pi * 3 * v) > 0.2)
    image = np.array(color) * (1 - bands[..., None]) + np.array(second) * bands[..., None]
    return finish(image * (1 + 0.05 * noise(rng, shape, falloff=1.2, smallest=2.5)[..., None]))


def stone(rng: np.random.Generator, *, color: Color, size: int = 256) -> np.ndarray:
    """Paint a worktop: speckles and veins."""
    shape = (size, size)
    vein = np.exp(-((noise(rng, shape, falloff=1.9) / 0.12) ** 2))
    speckle = noise(rng, shape, falloff=0.4, smallest=2.5)
    return finish(np.array(color) * (1 + 0.07 * speckle - 0.12 * vein)[..., None])


def rug(rng: np.random.Generator, *, colors: list[Color], size: int = 256) -> np.ndarray:
    """Paint a carpet that covers its surface once: bands along the border and a field of diamonds."""
    shape = (size, size)
    u, v = pixel_grid(shape)
    rim = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    palette = np.array(colors)
    repeat = int(rng.integers(3, 6))
    diamond = np.abs((u * repeat) % 1 - 0.5) + np.abs((v * repeat) % 1 - 0.5)
    field = np.where(diamond < 0.2, 2, np.where(diamond < 0.36, 1, 0))
    band = np.where(rim < 0.03, 1, np.where(rim < 0.09, 2, np.where(rim < 0.11, 1, field)))
    image = palette[band % len(palette)]
    pile = 0.06 * noise(rng, shape, falloff=0.8, smallest=2) + 0.05 * noise(rng, shape, falloff=2.0)
    return finish(image * (1 + pile[..., None]))
