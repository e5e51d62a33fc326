"""Every piece of the catalogue is made of closed solids and stays within its footprint."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural.furniture import BUILDERS, Piece, draw_piece, lights_of
from activestructure_gym.scenes.procedural.materials import Materials
from activestructure_gym.scenes.procedural.mesh_builder import MeshBuilder

SIZES = {
    "armchair": (0.85, 0.82, 0.82),
    "bathtub": (1.6, 0.72, 0.58),
    "bed": (1.6, 2.08, 1.02),
    "chair": (0.43, 0.44, 0.9),
    "coffee table": (1.05, 0.55, 0.42),
    "curtain": (0.32, 0.10, 2.26),
    "curtain rod": (1.8, 0.05, 0.035),
    "desk": (1.4, 0.68, 1.16),
    "dining table": (1.4, 0.8, 0.75),
    "dresser": (1.0, 0.42, 0.82),
    "floor lamp": (0.42, 0.42, 1.6),
    "fridge": (0.62, 0.65, 1.85),
    "front door": (1.0, 0.06, 2.08),
    "kitchen run": (2.4, 0.6, 0.9),
    "mat": (0.8, 0.5, 0.006),
    "media bench": (1.6, 0.40, 1.22),
    "nightstand": (0.45, 0.40, 0.90),
    "office chair": (0.6, 0.6, 0.95),
    "pendant": (0.4, 0.4, 0.65),
    "picture": (0.8, 0.03, 0.6),
    "plant": (0.7, 0.7, 1.3),
    "pouf": (0.5, 0.5, 0.42),
    "radiator": (1.2, 0.10, 0.75),
    "rug": (2.3, 1.5, 0.006),
    "shelf": (0.9, 0.3, 1.9),
    "sofa": (2.1, 0.92, 0.84),
    "splashback": (2.4, 0.012, 0.55),
    "toilet": (0.40, 0.66, 0.80),
    "towel rail": (0.5, 0.11, 1.05),
    "vanity": (0.8, 0.46, 1.86),
    "wall units": (1.8, 0.35, 0.7),
    "wardrobe": (2.0, 0.6, 2.15),
    "washing machine": (0.6, 0.6, 0.85),
    "window frame": (1.4, 0.06, 1.3),
}


@pytest.fixture(scope="module")
def materials() -> Materials:
    return Materials(0, detail=0.125)


def test_every_kind_is_tried() -> None:
    assert set(SIZES) == set(BUILDERS)


@pytest.mark.parametrize("kind", SIZES)
def test_pieces_are_solid_and_stay_on_their_footprint(kind: str, materials: Materials) -> None:
    piece = Piece(kind, x=3.0, y=2.0, yaw=np.pi / 2, size=SIZES[kind], base=0.1, seed=4)
    builder = MeshBuilder()
    draw_piece(builder, materials, piece)
    mesh = builder.build()
    lower, upper = piece.box
    # Handles and bulging cushions overstep by less than the 4 cm that free points keep off.
    assert (mesh.vertices > lower - 0.04).all() and (mesh.vertices < upper + 0.04).all()
    assert mesh.vertices[:, 2].min() >= 0.1 - 0.01
    # Every edge is used as often one way as the other: closed solids all through.
    _, merged = np.unique(mesh.vertices.round(5), axis=0, return_inverse=True)
    faces = merged.reshape(-1)[mesh.faces]
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    count = merged.max() + 1
    one_way, number = np.unique(edges[:, 0] * count + edges[:, 1], return_counts=True)
    back, back_number = np.unique(edges[:, 1] * count + edges[:, 0], return_counts=True)
    assert np.array_equal(one_way, back) and np.array_equal(number, back_number)
    # Its triangles are few enough that a flat with a hundred pieces stays below 200,000.
    assert len(mesh.faces) < 6000


def test_the_same_seed_draws_the_same_piece(materials: Materials) -> None:
    meshes = []
    for seed in (1, 1, 2):
        builder = MeshBuilder()
        draw_piece(builder, materials, Piece("shelf", 0, 0, 0, SIZES["shelf"], seed=seed))
        meshes.append(builder.build().vertices)
    assert np.array_equal(meshes[0], meshes[1])
    assert meshes[0].shape != meshes[2].shape or not np.array_equal(meshes[0], meshes[2])


def test_box_of_a_turned_piece() -> None:
    piece = Piece("wardrobe", x=1.0, y=2.0, yaw=np.pi / 2, size=(2.0, 0.6, 2.0), base=0.5)
    assert np.allclose(piece.box, [[0.7, 1.0, 0.5], [1.3, 3.0, 2.5]])
    # A quarter of a right angle: (2 + 0.6) / 2 * cos 45 deg to either side.
    tilted = Piece("wardrobe", x=0.0, y=0.0, yaw=np.pi / 4, size=(2.0, 0.6, 2.0))
    assert np.allclose(tilted.box[1, :2], 1.3 / np.sqrt(2))


def test_lamps_shine_from_outside_their_shade() -> None:
    pendant = Piece("pendant", 1.0, 1.0, 0.0, SIZES["pendant"], base=2.05)
    assert lights_of(pendant)[0].position[2] < 2.05
    lamp = Piece("floor lamp", 1.0, 1.0, 0.0, SIZES["floor lamp"])
    assert lights_of(lamp)[0].position[2] > 1.6
    assert lights_of(Piece("sofa", 0, 0, 0, SIZES["sofa"])) == []
