"""Small scenes with known answers."""

import numpy as np
import pytest

from activestructure_gym.geometry import look_along
from activestructure_gym.scenes.scene import Scene, SceneMesh
from activestructure_gym.sensors import renderer_status


def _quad(corners, normal_color, uv, texture):
    """Two triangles; corners [4, 3] in order around the quad."""
    return {
        "vertices": np.asarray(corners, np.float32),
        "faces": np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        "colors": np.broadcast_to(np.asarray(normal_color, np.float32), (4, 3)),
        "uv": np.asarray(uv, np.float32),
        "face_texture": np.full(2, texture, np.int32),
    }


def _merge(parts, textures=()):
    offsets = np.cumsum([0] + [len(part["vertices"]) for part in parts])
    joined = {key: np.concatenate([part[key] for part in parts]) for key in ("vertices", "colors", "uv")}
    return SceneMesh(
        faces=np.concatenate([part["faces"] + offset for part, offset in zip(parts, offsets)]).astype(np.int32),
        face_texture=np.concatenate([part["face_texture"] for part in parts]),
        textures=tuple(textures),
        **joined,
    )


def _box(low, high, *, repeat=1.0, textures=(-1,) * 6):
    """The six faces of an axis-aligned box, each with a colour ramp over its corners."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    parts = []
    for axis in range(3):
        for side in (0, 1):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            corners = np.empty((4, 3))
            corners[:, axis] = (low, high)[side][axis]
            corners[:, a] = [low[a], high[a], high[a], low[a]]
            corners[:, b] = [low[b], low[b], high[b], high[b]]
            ramp = 0.3 + 0.2 * np.array([[axis, side, 1.0], [2.0, side, axis], [1.0, 2.0, side], [0.5, axis, 2.0]])
            uv = repeat * np.array([[-1.3, 0.2], [1.4, 0.2], [1.4, 1.7], [-1.3, 1.7]])
            parts.append(_quad(corners, ramp, uv, textures[2 * axis + side]))
    return parts


def _rotated(parts, angle, centre):
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return [{**part, "vertices": ((part["vertices"] - centre) @ turn.T + centre).astype(np.float32)} for part in parts]


def _patches(height, width, seed):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.fixture(scope="session")
def make_quad():
    return _quad


@pytest.fixture(scope="session")
def merge():
    return _merge


@pytest.fixture(scope="session")
def box_room():
    """An empty room [0, 4] x [0, 3] x [0, 2.5] m: two walls and the floor textured, the others vertex-coloured."""
    textures = (_patches(5, 7, 1), _patches(16, 9, 2), _patches(3, 3, 3))
    parts = _box((0, 0, 0), (4, 3, 2.5), textures=(0, -1, 1, -1, 2, -1))
    return Scene("box", _merge(parts, textures), "tests")


@pytest.fixture(scope="session")
def cluttered_room():
    """The room with turned boxes in it: silhouettes, slanted faces, textures of odd widths seen from both sides."""
    textures = (_patches(5, 7, 1), _patches(16, 9, 2), _patches(3, 3, 3))
    parts = _box((0, 0, 0), (4, 3, 2.5), textures=(0, -1, 1, -1, 2, -1))
    rng = np.random.default_rng(5)
    for _ in range(12):
        centre, half = rng.uniform((0.4, 0.4, 0.2), (3.6, 2.6, 1.2)), rng.uniform(0.05, 0.3, 3)
        parts += _rotated(
            _box(centre - half, centre + half, textures=rng.integers(-1, 3, 6)), rng.uniform(0, np.pi), centre
        )
    return Scene("clutter", _merge(parts, textures), "tests")


@pytest.fixture(scope="session")
def room_poses():
    """Views from the upper part of the room in many directions, none along an axis."""
    rng = np.random.default_rng(7)
    return [look_along(rng.uniform((1.0, 0.8, 1.6), (3.0, 2.2, 2.2)), rng.normal(size=3)) for _ in range(8)]


@pytest.fixture(scope="session")
def status():
    """What a fresh process says about the renderers here."""
    return renderer_status()


@pytest.fixture
def needs_gl(status):
    if status["pyrender"] != "works":
        pytest.skip(status["pyrender"])
