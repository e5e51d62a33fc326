"""List all kinds of furniture by name, and add placed pieces to the mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from activestructure_gym.scenes.procedural import furniture_decor as decor
from activestructure_gym.scenes.procedural import furniture_fixtures as fixtures
from activestructure_gym.scenes.procedural import furniture_seating as seating
from activestructure_gym.scenes.procedural import furniture_storage as storage
from activestructure_gym.scenes.procedural.furniture_pen import Pen
from activestructure_gym.scenes.procedural.furniture_storage import Size
from activestructure_gym.scenes.procedural.materials import Materials
from activestructure_gym.scenes.procedural.mesh_builder import MeshBuilder

BUILDERS: dict[str, Callable[[Pen, Size], None]] = {
    "armchair": seating.armchair,
    "bathtub": fixtures.bathtub,
    "bed": seating.bed,
    "chair": seating.chair,
    "coffee table": seating.coffee_table,
    "curtain": decor.curtain,
    "curtain rod": decor.curtain_rod,
    "desk": storage.desk,
    "dining table": seating.dining_table,
    "dresser": storage.dresser,
    "floor lamp": decor.floor_lamp,
    "fridge": storage.fridge,
    "front door": decor.front_door,
    "kitchen run": fixtures.kitchen_run,
    "mat": decor.mat,
    "media bench": storage.media_bench,
    "nightstand": storage.nightstand,
    "office chair": seating.office_chair,
    "pendant": decor.pendant,
    "picture": decor.picture,
    "plant": decor.plant,
    "pouf": seating.pouf,
    "radiator": decor.radiator,
    "rug": decor.rug,
    "shelf": storage.shelf,
    "sofa": seating.sofa,
    "splashback": fixtures.splashback,
    "toilet": fixtures.toilet,
    "towel rail": fixtures.towel_rail,
    "vanity": fixtures.vanity,
    "wall units": fixtures.wall_units,
    "wardrobe": storage.wardrobe,
    "washing machine": fixtures.washing_machine,
    "window frame": decor.window_frame,
}
# Kinds of pieces that are parts of the building, not objects in it.
STRUCTURAL_KINDS = frozenset({"front door", "window frame"})
# Metres by which vases, pots and books extend above the piece of furniture that they are on.
_ON_TOP = {"bathtub": 0.13, "coffee table": 0.08, "dining table": 0.27, "dresser": 0.31, "kitchen run": 0.26}


@dataclass(frozen=True)
class Piece:
    """Hold one placed piece of furniture."""

    kind: str
    x: float  # metres, centre of the footprint
    y: float
    yaw: float  # radians; 0 = front towards +y
    size: Size  # metres: width, depth, height before rotation
    base: float = 0.0  # metres above the floor
    seed: int = 0  # seed of small variations

    @property
    def box(self) -> np.ndarray:  # [2, 3] metres
        """Return the axis-aligned box of the rotated piece, including objects on it."""
        cos, sin = abs(np.cos(self.yaw)), abs(np.sin(self.yaw))
        half_x = (cos * self.size[0] + sin * self.size[1]) / 2
        half_y = (sin * self.size[0] + cos * self.size[1]) / 2
        return np.array(
            [
                [self.x - half_x, self.y - half_y, self.base],
                [self.x + half_x, self.y + half_y, self.base + self.size[2] + _ON_TOP.get(self.kind, 0.0)],
            ]
        )


@dataclass(frozen=True)
class Light:
    """Hold a small lamp, which `bake_light` samples by point lights."""

    position: tuple[float, float, float]  # metres
    radius: float  # metres, horizontal extent, which softens shadows
    power: tuple[float, float, float]  # linear RGB irradiance of a surface 1 m below the lamp that faces it
    upward: float = 1.0  # light radiated straight up, as a fraction; below 1 for lamps whose shade is not in the mesh


def draw_piece(builder: MeshBuilder, materials: Materials, piece: Piece) -> None:
    """Add a piece of furniture to the mesh as a part of its own."""
    builder.part(piece.kind, structural=piece.kind in STRUCTURAL_KINDS)
    with builder.placed((piece.x, piece.y, piece.base), piece.yaw):
        BUILDERS[piece.kind](Pen(builder, materials, seed=piece.seed), piece.size)


def lights_of(piece: Piece) -> list[Light]:
    """Return the lights of a piece: below the shade of a pendant, above the shade of other lamps; [] without a lamp."""
    warm = np.array([1.0, 0.80, 0.58])  # about 3000 K, white-balanced halfway to daylight
    if piece.kind == "pendant":
        return [Light((piece.x, piece.y, piece.base - 0.06), 0.12, tuple(1.3 * warm))]
    if piece.kind == "floor lamp":
        return [Light((piece.x, piece.y, piece.size[2] + 0.05), 0.08, tuple(0.45 * warm))]
    if piece.kind == "nightstand":
        return [Light((piece.x, piece.y, piece.size[2] + 0.05), 0.06, tuple(0.22 * warm))]
    return []
