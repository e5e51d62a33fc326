"""Define an apartment's materials: a colour scheme drawn from the seed, textures painted on first use."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from activestructure_gym.scenes.procedural import pictures as pictures
from activestructure_gym.scenes.procedural import textures as textures
from activestructure_gym.scenes.procedural.mesh_builder import Material
from activestructure_gym.scenes.procedural.textures import Color


@dataclass(frozen=True)
class Scheme:
    """Define the colour scheme of an apartment: matching sRGB colours in 0..1."""

    walls: tuple[Color, Color, Color]  # used by rooms in turn
    accent: Color  # one wall of living room and bedroom
    sofa: Color
    textile: Color  # bedspread, armchair
    cushion: Color
    curtain: Color
    rug: tuple[Color, Color, Color]


SCHEMES = (
    Scheme(
        walls=((0.87, 0.84, 0.78), (0.80, 0.83, 0.80), (0.88, 0.86, 0.82)),
        accent=(0.52, 0.60, 0.56),
        sofa=(0.42, 0.47, 0.50),
        textile=(0.72, 0.68, 0.60),
        cushion=(0.70, 0.56, 0.38),
        curtain=(0.80, 0.77, 0.70),
        rug=((0.70, 0.65, 0.56), (0.42, 0.46, 0.46), (0.62, 0.45, 0.34)),
    ),
    Scheme(
        walls=((0.84, 0.84, 0.84), (0.86, 0.82, 0.76), (0.78, 0.81, 0.85)),
        accent=(0.42, 0.50, 0.60),
        sofa=(0.66, 0.60, 0.52),
        textile=(0.45, 0.52, 0.60),
        cushion=(0.36, 0.46, 0.56),
        curtain=(0.62, 0.66, 0.70),
        rug=((0.72, 0.70, 0.66), (0.36, 0.42, 0.52), (0.56, 0.54, 0.52)),
    ),
    Scheme(
        walls=((0.88, 0.85, 0.80), (0.85, 0.78, 0.70), (0.84, 0.85, 0.80)),
        accent=(0.70, 0.50, 0.41),
        sofa=(0.55, 0.38, 0.30),
        textile=(0.76, 0.71, 0.62),
        cushion=(0.50, 0.54, 0.40),
        curtain=(0.74, 0.66, 0.55),
        rug=((0.60, 0.36, 0.28), (0.74, 0.66, 0.52), (0.32, 0.32, 0.36)),
    ),
    Scheme(
        walls=((0.85, 0.86, 0.84), (0.80, 0.84, 0.78), (0.87, 0.84, 0.80)),
        accent=(0.40, 0.48, 0.42),
        sofa=(0.36, 0.44, 0.38),
        textile=(0.70, 0.62, 0.54),
        cushion=(0.80, 0.72, 0.56),
        curtain=(0.56, 0.60, 0.52),
        rug=((0.66, 0.62, 0.54), (0.38, 0.44, 0.38), (0.72, 0.58, 0.42)),
    ),
)
FLOOR_WOODS: tuple[Color, ...] = ((0.66, 0.50, 0.35), (0.55, 0.40, 0.28), (0.72, 0.60, 0.46), (0.60, 0.49, 0.40))
LIGHT_WOODS: tuple[Color, ...] = ((0.76, 0.62, 0.45), (0.70, 0.54, 0.37), (0.80, 0.70, 0.56))
DARK_WOODS: tuple[Color, ...] = ((0.42, 0.29, 0.20), (0.50, 0.34, 0.22), (0.36, 0.29, 0.25))

# Surfaces of a single colour: lacquer, metal, ceramics, paper.
PLAIN: dict[str, Color] = {
    "trim": (0.88, 0.87, 0.84),
    "white": (0.86, 0.85, 0.82),
    "ceramic": (0.90, 0.90, 0.88),
    "steel": (0.62, 0.63, 0.64),
    "dark metal": (0.20, 0.20, 0.21),
    "brass": (0.66, 0.54, 0.33),
    "mirror": (0.62, 0.68, 0.71),
    "soil": (0.25, 0.19, 0.15),
    "clay": (0.68, 0.45, 0.34),
    "stem": (0.36, 0.31, 0.22),
}


class Materials:
    """Provide the materials of a scene by name, such as "light wood" or "wall 2".

    ``textures`` holds the textures of the materials that have been used so far.
    """

    def __init__(self, seed: int, *, detail: float = 1.0, painted: bool = True) -> None:
        self._detail = detail  # factor on the size of all textures
        self._painted = painted  # False: every texture is a single white texel
        self.textures: list[np.ndarray] = []
        self._seed = seed
        self._index: dict[str, int] = {}
        rng = np.random.default_rng([seed, zlib.crc32(b"scheme")])
        self.scheme = SCHEMES[rng.integers(len(SCHEMES))]
        self._floor_tone = FLOOR_WOODS[rng.integers(len(FLOOR_WOODS))]
        self._light = LIGHT_WOODS[rng.integers(len(LIGHT_WOODS))]
        self._dark = DARK_WOODS[rng.integers(len(DARK_WOODS))]
        warm = rng.uniform(-0.04, 0.04)
        self._tile: Color = (0.74 + warm, 0.72, 0.69 - warm)
        # Kitchen fronts are white, wooden or painted in the accent colour.
        self._table_role, self._shelf_role = rng.permutation(["light wood", "dark wood"])
        self._front_role = ("white", "accent paint", "light wood")[rng.integers(3)]

    def _texture(self, key: str, paint: Callable[..., np.ndarray], *, size: int = 256, **options: Any) -> int:
        """Return the index of a texture of about size x size texels, painted on first use with its own generator."""
        if key not in self._index:
            self._index[key] = len(self.textures)
            if self._painted:
                rng = np.random.default_rng([self._seed, zlib.crc32(key.encode())])
                self.textures.append(paint(rng, size=round(size * self._detail), **options))
            else:
                self.textures.append(np.full((1, 1, 3), 255, np.uint8))
        return self._index[key]

    def __getitem__(self, role: str) -> Material:
        """Return the material for a role: a name in `PLAIN`, or ``wall 2``, ``floor bath``, ``light wood``, ..."""
        if role in PLAIN:
            return Material(tint=PLAIN[role])
        kind, _, detail = role.partition(" ")
        if kind in ("wall", "floor", "picture", "street"):
            return getattr(self, f"_{kind}")(detail)
        return getattr(self, "_" + role.replace(" ", "_"))()

    def tinted(self, role: str, tint: Color) -> Material:
        """Return the material of a role with another tint, an sRGB factor."""
        return replace(self[role], tint=tint)

    def glowing(self, tint: Color, glow: float) -> Material:
        """Return an emissive material for a lamp's shade; ``glow`` is the display value of its tint."""
        return Material(tint=tint, glow=glow)

    def _wall(self, detail: str) -> Material:
        if detail == "bath":
            tone = (0.84, 0.86, 0.86)
            paint = textures.tiles
            return Material(
                self._texture("wall bath", paint, color=tone, grout=(0.66, 0.67, 0.67), count=(6, 4)), repeats=0.8
            )
        if detail == "paper":
            color = self.scheme.walls[0]
            second: Color = tuple(0.5 * (a + b) for a, b in zip(color, self.scheme.accent))  # type: ignore[assignment]
            return Material(self._texture("wall paper", textures.wallpaper, color=color, second=second), repeats=1.4)
        color = self.scheme.accent if detail == "accent" else self.scheme.walls[int(detail) % 3]
        return Material(self._texture(f"wall {detail}", textures.plaster, color=color), repeats=0.6)

    def _floor(self, detail: str) -> Material:
        if detail in ("bath", "kitchen"):
            tone = self._tile if detail == "kitchen" else (0.56, 0.58, 0.60)
            key = f"floor {detail}"
            return Material(self._texture(key, textures.tiles, color=tone, grout=(0.50, 0.49, 0.47)), repeats=0.75)
        return Material(self._texture("planks", textures.planks, size=512, color=self._floor_tone), repeats=0.8)

    def _ceiling(self) -> Material:
        return Material(self._texture("ceiling", textures.plaster, color=(0.90, 0.89, 0.87), stains=0.006), repeats=0.5)

    def _light_wood(self) -> Material:
        return Material(self._texture("light wood", textures.wood, color=self._light), repeats=1.3)

    def _dark_wood(self) -> Material:
        return Material(self._texture("dark wood", textures.wood, color=self._dark), repeats=1.3)

    def _table_wood(self) -> Material:
        return self[self._table_role]

    def _shelf_wood(self) -> Material:
        return self[self._shelf_role]

    def _accent_paint(self) -> Material:
        return Material(tint=self.scheme.accent)

    def _fronts(self) -> Material:
        return self[self._front_role]

    def _sofa(self) -> Material:
        return Material(self._texture("sofa", textures.fabric, color=self.scheme.sofa), repeats=1.5)

    def _textile(self) -> Material:
        return Material(self._texture("textile", textures.fabric, color=self.scheme.textile), repeats=1.5)

    def _cushion(self) -> Material:
        return Material(self._texture("cushion", textures.fabric, color=self.scheme.cushion, threads=32), repeats=2.0)

    def _bedspread(self) -> Material:
        light: Color = tuple(0.35 * c + 0.55 for c in self.scheme.textile)  # type: ignore[assignment]
        key = "bedspread"
        return Material(
            self._texture(key, textures.checked_fabric, color=self.scheme.textile, second=light), repeats=0.9
        )

    def _linen(self) -> Material:
        return Material(
            self._texture("linen", textures.fabric, color=(0.86, 0.85, 0.81), threads=40, strength=0.5), repeats=1.5
        )

    def _curtain(self) -> Material:
        return Material(
            self._texture("curtain", textures.fabric, color=self.scheme.curtain, threads=32, strength=0.7), repeats=1.2
        )

    def _rug(self) -> Material:
        return Material(self._texture("rug", textures.rug, colors=list(self.scheme.rug)))

    def _mat(self) -> Material:
        return Material(self._texture("mat", textures.fabric, color=self.scheme.cushion, threads=24), repeats=1.5)

    def _worktop(self) -> Material:
        return Material(self._texture("worktop", textures.stone, color=(0.46, 0.44, 0.42)), repeats=1.2)

    def _backsplash(self) -> Material:
        tone = (0.82, 0.84, 0.83)
        paint = textures.tiles
        return Material(
            self._texture("backsplash", paint, color=tone, grout=(0.62, 0.63, 0.62), count=(8, 4)), repeats=1.2
        )

    def _foliage(self) -> Material:
        return Material(
            self._texture("foliage", textures.plaster, color=(0.36, 0.44, 0.28), stains=0.05, size=128), repeats=3.0
        )

    def _door(self) -> Material:
        return self["light wood"]

    def _screen(self) -> Material:
        return Material(self._texture("screen", pictures.screen, size=128))

    def _oven(self) -> Material:
        return Material(self._texture("oven", pictures.appliance, size=128, color=(0.58, 0.59, 0.60)))

    def _picture(self, detail: str) -> Material:
        paint = (pictures.landscape, pictures.abstract, pictures.still_life)[int(detail) % 3]
        return Material(self._texture(f"picture {detail}", paint))

    def _street(self, detail: str) -> Material:
        # The pane shows the sky, which has the maximum brightness of the display at any exposure.
        return Material(self._texture(f"street {detail}", pictures.street), glow=1.08)
