"""Textures tile, repeat from their generator, and are as calm as they are meant to be."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural import pictures as pictures
from activestructure_gym.scenes.procedural import textures as textures
from activestructure_gym.scenes.procedural.materials import PLAIN, Materials

GREY = (0.5, 0.5, 0.5)
TILING = {
    "plaster": lambda rng: textures.plaster(rng, color=GREY, size=64),
    "wallpaper": lambda rng: textures.wallpaper(rng, color=GREY, second=(0.4, 0.4, 0.5), size=64),
    "planks": lambda rng: textures.planks(rng, color=GREY, size=64),
    "wood": lambda rng: textures.wood(rng, color=GREY, size=64),
    "tiles": lambda rng: textures.tiles(rng, color=GREY, grout=(0.3, 0.3, 0.3), size=64),
    "fabric": lambda rng: textures.fabric(rng, color=GREY, size=64, threads=8),
    "stone": lambda rng: textures.stone(rng, color=GREY, size=64),
}


@pytest.mark.parametrize("name", TILING)
def test_textures_tile(name: str) -> None:
    image = TILING[name](np.random.default_rng(0)).astype(float)
    assert image.shape == (64, 64, 3)
    for axis in (0, 1):
        inner = np.abs(np.diff(image, axis=axis)).mean(axis=(1 - axis, 2))
        seam = np.abs(np.take(image, 0, axis) - np.take(image, -1, axis)).mean()
        # No step across the border is larger than the largest step inside (joints of boards and tiles are steps too).
        assert seam <= 1.3 * inner.max() + 1.0


@pytest.mark.parametrize("name", TILING)
def test_textures_are_functions_of_their_generator(name: str) -> None:
    first, same, other = (TILING[name](np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first.dtype == np.uint8 and np.array_equal(first, same) and not np.array_equal(first, other)


def test_noise_is_normalised_and_smoother_with_more_falloff() -> None:
    rng = np.random.default_rng(0)
    rough, smooth = textures.noise(rng, (64, 64), falloff=0.8), textures.noise(rng, (64, 64), falloff=2.2)
    for field in (rough, smooth):
        assert abs(field.mean()) < 1e-9 and np.isclose(field.std(), 1)
    assert np.abs(np.diff(smooth, axis=0)).mean() < 0.5 * np.abs(np.diff(rough, axis=0)).mean()
    grain = textures.noise(rng, (64, 64), stretch=10.0)
    assert np.abs(np.diff(grain, axis=1)).mean() < 0.5 * np.abs(np.diff(grain, axis=0)).mean()


def test_contrast_is_a_quarter_lower_than_painted() -> None:
    image = np.random.default_rng(0).uniform(0.3, 0.7, (32, 32, 3))
    assert textures.CONTRAST == 0.75
    finished = textures.finish(image) / 255
    assert np.isclose(finished.std(axis=(0, 1)).mean(), 0.75 * image.std(axis=(0, 1)).mean(), rtol=0.01)


@pytest.mark.parametrize("paint", [pictures.landscape, pictures.abstract, pictures.still_life, pictures.street])
def test_pictures_have_something_on_them(paint) -> None:
    image = paint(np.random.default_rng(1), size=64)
    assert image.shape == (64, 64, 3) and image.dtype == np.uint8
    assert image.std() > 10


def test_materials_do_not_depend_on_the_order_they_are_asked_for() -> None:
    roles = ["wall 1", "floor living", "sofa", "picture 2", "street 9", "fronts", "foliage"]
    first, second = Materials(3, detail=0.25), Materials(3, detail=0.25)
    forward = {role: first[role] for role in roles}
    backward = {role: second[role] for role in reversed(roles)}
    for role in roles:
        a, b = forward[role], backward[role]
        assert (a.tint, a.repeats, a.glow) == (b.tint, b.repeats, b.glow)
        if a.texture >= 0:
            assert np.array_equal(first.textures[a.texture], second.textures[b.texture])
    assert first["sofa"] is not None and len(first.textures) == len(second.textures)


def test_plain_colours_need_no_texture() -> None:
    materials = Materials(0)
    assert {materials[name].texture for name in PLAIN} == {-1}
    assert materials.textures == []
