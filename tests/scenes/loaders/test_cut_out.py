from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.scenes.loaders import cut_out as module
from activestructure_gym.scenes.loaders.cut_out import cut_out
from activestructure_gym.scenes.loaders.mesh_parts import MeshPart
from activestructure_gym.scenes.loaders.opacity import Opacity, OpacityPicture
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], dtype=np.float64)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = SQUARE[:, :2] / 2


def _part(opacity: Opacity | None, **more) -> MeshPart:
    return MeshPart(SQUARE, FACES, np.ones(3), opacity=opacity, **more)


def _area(part: MeshPart) -> float:
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _covered(part: MeshPart, points: np.ndarray) -> np.ndarray:
    """Whether points [N, 2] lie in a triangle of the part (z is 0)."""
    corners = part.vertices[part.faces][:, :, :2]
    sides = np.roll(corners, -1, axis=1) - corners
    covered = np.zeros(len(points), dtype=bool)
    for corner, side in zip(corners, sides):
        offset = points[:, None] - corner
        turns = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]
        covered |= (turns >= 0).all(axis=1) | (turns <= 0).all(axis=1)
    return covered


@pytest.mark.parametrize("opacity", [None, Opacity(), Opacity(0.5), Opacity(0.2, cutoff=0.2), Opacity(0.7, cutoff=0.0)])
def test_what_is_solid_is_not_touched(opacity):
    part = _part(opacity)
    (solid,), found = cut_out([part])
    assert solid.vertices is part.vertices and solid.faces is part.faces and solid.opacity is None
    assert (found.gone, found.cut) == (0, 0)


def test_the_cutoff_in_float32_is_the_cutoff():
    for cutoff in (0.1, 0.3, 0.7, 0.9):
        vertices = np.full(4, cutoff, np.float32)
        assert len(cut_out([_part(Opacity(cutoff=cutoff, vertices=vertices))])[0]) == 1


def test_what_is_transparent_goes_and_is_counted():
    parts, found = cut_out([_part(Opacity(0.49)), _part(None), _part(Opacity(0.9, cutoff=0.91))])
    assert len(parts) == 1 and found.gone == 4
    assert found.notes() == ["4 faces are transparent in the file and are left out"]


def test_glass_is_solid_and_counted_unless_the_file_has_a_cutoff():
    assert cut_out([_part(Opacity(0.6))])[1].notes() == [
        "2 faces are translucent in the file (opacity of 0.5 or more) and solid here"
    ]
    assert cut_out([_part(Opacity(0.6, blended=False))])[1].notes() == []


def test_values_at_vertices_are_cut_along_one_line():
    """Opacity x / 2 on the square: from x = 1 on it is solid. The colours go on as they were."""
    colors = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    part = MeshPart(SQUARE, FACES, colors, uv=UV, texture=0, opacity=Opacity(vertices=SQUARE[:, 0] / 2))
    (solid,), found = cut_out([part])
    assert _area(solid) == pytest.approx(2.0, abs=1e-4) and found.cut == 2 and found.pieces == len(solid.faces) == 3
    np.testing.assert_allclose(solid.colors[:, :2], solid.vertices[:, :2] / 2, atol=1e-9)
    np.testing.assert_allclose(solid.uv, solid.vertices[:, :2] / 2, atol=1e-9)
    assert solid.vertices[:, 0].min() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("wrap", [(REPEAT, REPEAT), (CLAMP, MIRROR)])
def test_a_picture_is_followed_to_its_pixels(rng, wrap):
    """Oracle: the bilinear lookup at random points. Only points next to the outline may differ."""
    picture = np.where(rng.random((6, 5)) < 0.5, 0, 255).astype(np.uint8)
    uv = UV * 1.7 - 0.3
    opacity = Opacity(picture=picture, uv=uv, wrap=wrap)
    (solid,), found = cut_out([_part(opacity)])
    points = rng.uniform(0, 2, (800, 2))
    lookup = OpacityPicture(picture, wrap)
    value = lookup.at((points / 2 * 1.7 - 0.3) * lookup.size)
    clear = np.abs(value - 0.5) > 0.1
    assert clear.mean() > 0.7
    np.testing.assert_array_equal(_covered(solid, points)[clear], value[clear] > 0.5)
    assert found.pieces < 8000


def test_pieces_are_not_split_below_a_centimetre_whatever_the_unit(rng):
    picture = np.where(rng.random((400, 400)) < 0.5, 0, 255).astype(np.uint8)
    part = MeshPart(10.0 * SQUARE, FACES, np.ones(3), opacity=Opacity(picture=picture, uv=UV))
    (solid,), found = cut_out([part], metres_per_unit=0.01)  # 0.2 m wide
    sides = np.linalg.norm(np.diff(solid.vertices[solid.faces], axis=1), axis=2)
    assert np.percentile(sides, 99) > 0.2 and found.finest == 0.01  # half a centimetre would be 0.5
    assert found.pieces < 4000 and _area(solid) == pytest.approx(200, rel=0.2)


def test_where_there_would_be_too_many_pieces_the_steps_are_wider(rng, monkeypatch):
    monkeypatch.setattr(module, "_MAX_PIECES", 3000)
    picture = np.where(rng.random((200, 200)) < 0.5, 0, 255).astype(np.uint8)
    (solid,), found = cut_out([_part(Opacity(picture=picture, uv=UV))])
    assert found.finest > 0.01 and found.pieces <= 3010 and _area(solid) == pytest.approx(2.0, rel=0.2)
    assert f"down to {100 * found.finest:g} cm" in found.notes()[0]


def test_a_picture_and_values_at_vertices_multiply():
    """0.8 x 0.8 is solid, 0.8 x 0.5 is not: the picture is grey, so the outline is a straight line."""
    picture = np.full((2, 2), 204, np.uint8)
    opacity = Opacity(picture=picture, uv=UV, vertices=SQUARE[:, 0] / 2)
    (solid,), _ = cut_out([_part(opacity)])
    assert _area(solid) == pytest.approx(4 * (1 - 0.5 / 0.8), rel=0.02)  # solid where x / 2 is at least 0.625


def test_odd_coordinates_do_no_harm(monkeypatch):
    monkeypatch.setattr(module, "_MAX_PIECES", 1000)
    uv = UV.copy()
    uv[0] = np.nan, 1e30
    picture = np.array([[0, 255], [255, 0]], np.uint8)
    parts, _ = cut_out([_part(Opacity(picture=picture, uv=uv))])
    assert all(np.isfinite(part.vertices).all() for part in parts)
