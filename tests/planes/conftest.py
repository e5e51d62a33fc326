"""Hand-made scenes of rectangles, ray-cast into frames: exact ground truth for every pixel, in milliseconds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.planes import PlaneDetectionConfig, PlaneGraphConfig, PlaneSceneGraph
from activestructure_gym.scenes.raycaster import RayCaster


class Rectangles:
    """A scene of rectangles, one part number each."""

    def __init__(self) -> None:
        self.corners: list[np.ndarray] = []  # [4, 3] each, in order around
        self._caster: RayCaster | None = None

    def add(self, corner: tuple, first: tuple, second: tuple) -> Rectangles:
        """The rectangle from ``corner`` along two edge vectors."""
        c, a, b = (np.asarray(v, dtype=np.float64) for v in (corner, first, second))
        self.corners.append(np.stack([c, c + a, c + a + b, c + b]))
        self._caster = None
        return self

    def box(self, low: tuple, high: tuple) -> Rectangles:
        """All six sides of a box: a room from inside, a cupboard from outside."""
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        x, y, z = np.diag(high - low)
        for corner, first, second in (
            (low, x, y), (low, x, z), (low, y, z), (high, -x, -y), (high, -x, -z), (high, -y, -z)
        ):  # fmt: skip
            self.add(corner, first, second)
        return self

    def plane(self, part: int) -> tuple[np.ndarray, float]:
        """Normal (either side) and n . x of a part."""
        c = self.corners[part]
        normal = np.cross(c[1] - c[0], c[3] - c[0])
        normal /= np.linalg.norm(normal)
        return normal, float(normal @ c[0])

    def shoot(
        self,
        position: tuple,
        direction: tuple,
        *,
        size: tuple[int, int] = (160, 90),
        noise: float = 0.0,  # times the Kinect model
        rng: np.random.Generator | None = None,
    ) -> tuple[Frame, np.ndarray]:
        """A frame and the part number of every pixel (-1 where nothing was hit)."""
        if self._caster is None:
            count = len(self.corners)
            faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
            self._caster = RayCaster(np.concatenate(self.corners), faces, threads=1)
        camera = PinholeCamera.from_size(*size)
        pose = look_along(np.asarray(position, dtype=np.float64), np.asarray(direction, dtype=np.float64))
        rays = camera.rays().reshape(-1, 3) @ pose[:3, :3].T.astype(np.float32)
        hits = self._caster.cast(pose[:3, 3], rays)
        shape = (camera.height, camera.width)
        depth = np.where(np.isfinite(hits.distance), hits.distance, 0.0).reshape(shape)
        if noise:
            sigma = noise * (0.0012 + 0.0019 * (depth - 0.4) ** 2)
            depth = depth + (depth > 0) * sigma * rng.standard_normal(shape)
        part = np.where(hits.face >= 0, hits.face // 2, -1).reshape(shape)
        return Frame(np.zeros((*shape, 3), np.uint8), depth.astype(np.float32), pose, camera), part


@pytest.fixture
def rectangles() -> type[Rectangles]:
    return Rectangles


@pytest.fixture
def box_room() -> Rectangles:
    """An empty closed room, 4.3 x 3.1 x 2.5 m (no two sides alike, so no ties in the tree)."""
    return Rectangles().box((0, 0, 0), (4.3, 3.1, 2.5))


@pytest.fixture
def furnished_room() -> Rectangles:
    """A room with a table on legs, a cupboard, a sofa and two boxes: 78 rectangles."""
    room = Rectangles().box((0, 0, 0), (5.5, 4.2, 2.7)).box((2, 1.5, 0.70), (3.4, 2.3, 0.75))
    for x in (2.02, 3.32):
        for y in (1.52, 2.22):
            room.box((x, y, 0), (x + 0.06, y + 0.06, 0.70))
    room.box((0.02, 1, 0), (0.62, 2.2, 2.0))
    room.box((3.4, 3.3, 0), (5.2, 4.1, 0.42)).box((3.4, 3.95, 0.42), (5.2, 4.15, 0.85))
    return room.box((4.6, 0.3, 0), (5.2, 0.9, 0.6)).box((1.2, 3.2, 0), (1.8, 3.9, 0.9))


@pytest.fixture
def furnished_views() -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions outside the furniture of `furnished_room`, with directions."""
    rng = np.random.default_rng(5)
    solid = np.array([[[2, 1.5, 0], [3.4, 2.3, 0.75]], [[0, 1, 0], [0.62, 2.2, 2]], [[3.4, 3.3, 0], [5.2, 4.15, 0.85]]])
    views = []
    while len(views) < 24:
        position = rng.uniform([0.8, 0.5, 1.0], [5.0, 3.2, 1.7])
        angle, pitch = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.1)
        if not ((position > solid[:, 0] - 0.3) & (position < solid[:, 1] + 0.3)).all(axis=1).any():
            views.append((position, np.array([np.cos(angle), np.sin(angle), pitch])))
    return views


@pytest.fixture
def new_graph() -> Callable[..., PlaneSceneGraph]:
    """A graph for depth of the given noise (0 = none)."""

    def make(noise: float = 0.0) -> PlaneSceneGraph:
        return PlaneSceneGraph(PlaneGraphConfig(detection=PlaneDetectionConfig(depth_noise_scale=max(noise, 0.25))))

    return make
