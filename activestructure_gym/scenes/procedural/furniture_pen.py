"""Draw furniture from solids, given by corner points and material roles in the piece's own frame.

The centre of a piece's footprint is the origin, its back at y = -depth / 2, its front towards +y, its feet on z = 0.
Free-standing parts are at least 2.5 cm thick, so that an occupancy grid includes them.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from activestructure_gym.scenes.procedural import mesh_shapes
from activestructure_gym.scenes.procedural.materials import Materials
from activestructure_gym.scenes.procedural.mesh_builder import Material, MeshBuilder
from activestructure_gym.scenes.procedural.mesh_shapes import Shape

Point = Sequence[float]


class Pen:
    """Add solids to a mesh builder, with materials by role name such as "light wood"; lengths are metres."""

    def __init__(self, builder: MeshBuilder, materials: Materials, *, seed: int) -> None:
        self.builder = builder
        self.materials = materials
        self.seed = seed
        self.rng = np.random.default_rng([seed, zlib.crc32(b"piece")])

    def add(self, shape: Shape, role: str | Material, *, shift: bool = True) -> None:
        """Add any shape; ``shift`` offsets the texture randomly, so that equal pieces look different."""
        material = self.materials[role] if isinstance(role, str) else role
        if shift and material.texture >= 0:
            shape = replace(shape, uv=shape.uv + self.rng.random(2))
        self.builder.add(shape, material)

    def box(self, lower: Point, upper: Point, role: str | Material, *, max_edge: float = mesh_shapes.MAX_EDGE) -> None:
        """Draw a box with sharp edges between two opposite corners."""
        self.add(mesh_shapes.box(np.array(lower), np.array(upper), max_edge=max_edge), role)

    def panel(self, lower: Point, upper: Point, role: str | Material) -> None:
        """Draw a box with an image stretched over each side."""
        self.add(mesh_shapes.box(np.array(lower), np.array(upper), fit=True), role, shift=False)

    def soft(
        self, lower: Point, upper: Point, role: str | Material, *, radius: float = 0.04, puff: float = 0.0
    ) -> None:
        """Draw a box with round edges of ``radius``; the middle of each side bulges out by ``puff`` metres."""
        self.add(mesh_shapes.rounded_box(np.array(lower), np.array(upper), radius=radius, puff=puff), role)

    def post(self, x: float, y: float, bottom: float, top: float, role: str | Material, *, width: float = 0.04) -> None:
        """Draw an upright post with a square section, such as a leg, with its centre at (x, y)."""
        half = width / 2
        self.box((x - half, y - half, bottom), (x + half, y + half, top), role)

    def legs(self, width: float, depth: float, top: float, role: str | Material, *, thick: float = 0.05) -> None:
        """Draw four legs at the corners of a width x depth footprint."""
        x, y = width / 2 - thick / 2, depth / 2 - thick / 2
        for sign_x in (-1, 1):
            for sign_y in (-1, 1):
                self.post(sign_x * x, sign_y * y, 0.0, top, role, width=thick)

    def turned(
        self, profile: Sequence[Point], role: str | Material, *, at: Point = (0, 0, 0), segments: int = 16
    ) -> None:
        """Draw a solid of revolution around the vertical axis through ``at``, from its (radius, height) profile."""
        with self.builder.placed(tuple(at)):  # type: ignore[arg-type]
            self.add(mesh_shapes.lathe(np.array(profile), segments=segments), role)

    def round(
        self,
        x: float,
        y: float,
        bottom: float,
        top: float,
        role: str | Material,
        *,
        radius: float,
        top_radius: float | None = None,
        segments: int = 12,
    ) -> None:
        """Draw an upright cylinder with its centre at (x, y); with ``top_radius``, a truncated cone."""
        with self.builder.placed((x, y, 0.0)):
            self.add(
                mesh_shapes.cylinder(radius, bottom, top, top_radius=top_radius, segments=segments),
                role,
            )
