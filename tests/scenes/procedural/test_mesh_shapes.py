"""Every solid is closed, wound outwards, and as large as its formula says."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.procedural.mesh_shapes import (
    Shape,
    box,
    cylinder,
    extrusion,
    join,
    lathe,
    leaf,
    lines,
    lying,
    rounded_box,
)


def open_edges(shape: Shape) -> int:
    """Directed edges without a partner the other way round, after merging vertices at the same place."""
    _, merged = np.unique(shape.vertices.round(9), axis=0, return_inverse=True)
    faces = merged.reshape(-1)[shape.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    count = merged.max() + 1
    forward = np.bincount(edges[:, 0] * count + edges[:, 1], minlength=count**2)
    backward = np.bincount(edges[:, 1] * count + edges[:, 0], minlength=count**2)
    return int(np.abs(forward - backward).sum())


def volume(shape: Shape) -> float:
    """Divergence theorem: positive for faces wound counter-clockwise seen from outside."""
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def curtain_outline() -> np.ndarray:
    x = np.linspace(0, 1, 12)
    wave = 0.05 * np.sin(9 * x)
    return np.stack([np.stack([x, wave - 0.02], 1), np.stack([x, wave + 0.02], 1)], axis=1)


SHAPES = {
    "box": box(np.zeros(3), np.array([1.0, 0.4, 0.3])),
    "picture": box(np.zeros(3), np.array([1.0, 0.4, 0.3]), fit=True),
    "cushion": rounded_box(np.zeros(3), np.array([0.6, 0.5, 0.2]), radius=0.05, puff=0.02),
    "vase": lathe(np.array([(0, 0), (0.1, 0), (0.05, 0.3), (0.08, 0.4), (0, 0.4)])),
    "bowl": lathe(np.array([(0, 0), (0.05, 0), (0.12, 0.06), (0.10, 0.06), (0.04, 0.02), (0, 0.02)])),
    "cone": cylinder(0.2, 0.0, 1.0, top_radius=0.1),
    "lying": lying(cylinder(0.2, 0.0, 1.0)),
    "curtain": extrusion(curtain_outline(), 0.0, 2.0),
    "leaf": leaf(0.3, 0.12, 0.025, 0.1),
}


@pytest.mark.parametrize("name", SHAPES)
def test_solids_are_closed_and_wound_outwards(name: str) -> None:
    shape = SHAPES[name]
    assert open_edges(shape) == 0
    assert volume(shape) > 0
    corner = shape.vertices[shape.faces]
    face_normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    agreement = (face_normal * shape.normals[shape.faces].sum(axis=1)).sum(axis=1)
    assert (agreement > 0).all()
    assert np.allclose(np.linalg.norm(shape.normals, axis=1), 1)
    assert len(shape.uv) == len(shape.vertices)


def test_volumes_by_hand() -> None:
    assert volume(SHAPES["box"]) == pytest.approx(1.0 * 0.4 * 0.3)
    # A wall 4 cm thick along a curve of length x: its cross section is 1 m x 0.04 m whatever the wave.
    assert volume(SHAPES["curtain"]) == pytest.approx(0.04 * 1.0 * 2.0)
    # A prism over a regular 12-gon of radius 0.2: 6 r^2 sin(30 deg) = 0.12 m^2, 1 m high.
    assert volume(SHAPES["lying"]) == pytest.approx(6 * 0.2**2 * 0.5)
    # A rounded box without puff is smaller than the box and larger than the box without its shell of radius r.
    assert 0.5 * 0.4 * 0.1 < volume(rounded_box(np.zeros(3), np.array([0.6, 0.5, 0.2]), radius=0.05)) < 0.06


def test_lying_turns_up_into_forward() -> None:
    assert lying(SHAPES["cone"]).vertices[:, 1].max() == pytest.approx(1.0)
    assert np.ptp(lying(SHAPES["cone"]).vertices[:, 2]) == pytest.approx(0.4)


def test_edges_are_short_enough_for_the_light() -> None:
    shape = box(np.zeros(3), np.array([2.0, 1.0, 0.1]), max_edge=0.25)
    corner = shape.vertices[shape.faces]
    # The diagonal of a 0.25 m square is the longest edge there can be.
    assert np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=-1).max() <= 0.25 * np.sqrt(2) + 1e-9
    assert np.allclose(lines(0.0, 1.0, 0.25), [0, 0.25, 0.5, 0.75, 1])


def test_texture_runs_in_metres_and_pictures_from_corner_to_corner() -> None:
    # The largest side is 1 m x 0.4 m: its u spans 1 m along the longer edge.
    assert np.ptp(SHAPES["box"].uv[:, 0]) == pytest.approx(1.0)
    picture = SHAPES["picture"]
    front = picture.normals[:, 1] < -0.5  # the side seen from -y
    assert picture.uv[front].min() == 0 and picture.uv[front].max() == 1
    top = picture.vertices[front][:, 2] == 0.3
    assert np.allclose(picture.uv[front][top][:, 1], 0)  # images run down


def test_joined_shapes_keep_their_volume() -> None:
    both = join([SHAPES["box"], SHAPES["cone"]])
    assert volume(both) == pytest.approx(volume(SHAPES["box"]) + volume(SHAPES["cone"]))


def test_impossible_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="upper > lower"):
        box(np.zeros(3), np.array([1.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match="on the axis"):
        lathe(np.array([(0.1, 0), (0.1, 1)]))
