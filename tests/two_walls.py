"""A map of two walls: the east one was seen three times, the west one once, north and south never."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.features import FeatureContext
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.mapping import Mapper, MapperConfig
from activestructure_gym.sensors import Frame
from activestructure_gym.volume import VolumeConfig, VoxelVolume

SENSOR = PinholeCamera.from_size(32, 24)
CANDIDATES = PinholeCamera.from_size(16, 12, 60.0)  # narrower, so that looking north shows nothing of the walls
EAST, WEST, NORTH = (np.array(axis, float) for axis in ([1, 0, 0], [-1, 0, 0], [0, 1, 0]))


def wall_frame(direction: np.ndarray, shift: float = 0.0, brightness: int = 0) -> Frame:
    """A wall 2 m ahead of a camera at the origin, or nearer by ``shift``; the same picture in each direction."""
    colours = np.random.default_rng(5).integers(40, 215, (24, 32, 3)) + brightness
    depth = np.full((24, 32), 2.0 - shift, np.float32)
    return Frame(colours.astype(np.uint8), depth, look_along(shift * direction, direction), SENSOR)


class TwoWalls:
    """What a gain asks for, around one real mapper that never takes a step."""

    def __init__(self) -> None:
        # One Gaussian per pixel of a wall 2 m ahead, where they are 12.5 cm apart.
        config = MapperConfig(seed_spacing=0.12, seed_pixels=1.0, seed_footprint=0.6, seed_opacity=0.9)
        self.mapper = Mapper(config, np.random.default_rng(0))
        self.volume = VoxelVolume(np.array([[-3.0] * 3, [3.0] * 3]), VolumeConfig())

    def see(self, frame: Frame) -> None:
        self.mapper.observe(frame, iterations=0)
        self.volume.integrate(frame)

    def know(self, state: int) -> None:
        """All space is in this state, and whatever was looked through is forgotten."""
        self.volume.state[:] = state
        self.volume.weight[:] = 0

    def context(self, *poses: np.ndarray, **changes: Any) -> FeatureContext:
        options: dict[str, Any] = {
            "mapper": self.mapper,
            "volume": self.volume,
            "planes": SimpleNamespace(nodes=[]),
            "camera": CANDIDATES,
            "bounds": np.array([[-3.0] * 3, [3.0] * 3]),
            "coverage_alpha": 0.5,
            "max_range": 10.0,
            "world_from_camera": np.array(poses),
        }
        return FeatureContext(**{**options, **changes})


@pytest.fixture
def two_walls() -> TwoWalls:
    made = TwoWalls()
    for direction, shift in ((EAST, 0.0), (EAST, 0.02), (EAST, 0.04), (WEST, 0.0)):
        made.see(wall_frame(direction, shift))
    return made


@pytest.fixture
def looks() -> tuple[np.ndarray, ...]:
    """East, west and north from the origin."""
    return tuple(look_along(np.zeros(3), direction) for direction in (EAST, WEST, NORTH))


@pytest.fixture
def frame_of():
    return wall_frame


@pytest.fixture
def hand_made(monkeypatch):
    """Two Gaussians of which all is given: the first has information in all it is known by, the second none.

    The first one's is 4 by mean, 9 by log-scale, 2 by logit and 5 by colour, so these are the units. Two candidates:
    one tells of both one unit by mean and logit, the other one unit of everything.
    """
    from activestructure_gym.features import information
    from activestructure_gym.policies.popgs import block_features as popgs_block
    from activestructure_gym.policies.popgs import features as popgs
    from activestructure_gym.splatting.fisher import DIAGONAL, ViewInformation

    known = np.zeros((2, 24))
    known[0, DIAGONAL], known[0, 21], known[0, 22] = [4, 4, 4, 9, 9, 9], 2, 5
    told = np.zeros((2, 2, 26), np.float32)
    told[:, :, DIAGONAL[:3]], told[:, :, 21] = 4, 2
    told[1][:, DIAGONAL[3:]], told[1][:, 22] = 9, 5
    none = np.zeros((1, 1))
    views = [ViewInformation(none, none, none, none, np.arange(2), numbers) for numbers in told]
    for module in (information, popgs, popgs_block):
        monkeypatch.setattr(module, "informed_views", lambda context: iter(views))
    made = TwoWalls()
    made.mapper = SimpleNamespace(memory={information._Trained: SimpleNamespace(of=lambda mapper: known)})
    return made.context(np.eye(4), np.eye(4))
