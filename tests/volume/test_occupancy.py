"""The probability that a voxel is occupied follows the volume's evidence, and agrees with its states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN, VoxelVolume
from activestructure_gym.volume.occupancy import occupancy

ROOM = np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]])
CAMERA = PinholeCamera.from_size(64, 36)


@pytest.fixture(scope="module")
def volume(cast_boxes: Callable) -> VoxelVolume:
    made, caster = VoxelVolume(ROOM), cast_boxes(ROOM)
    for angle in np.linspace(0.0, 2.0, 4):
        pose = look_along(np.array([2.0, 1.5, 1.2]), np.array([np.cos(angle), np.sin(angle), 0.0]))
        distance = caster.cast(pose[:3, 3], CAMERA.rays().reshape(-1, 3) @ pose[:3, :3].T).distance
        depth = np.where(np.isfinite(distance), distance, 0.0).astype(np.float32).reshape(36, 64)
        made.integrate(Frame(np.zeros((36, 64, 3), np.uint8), depth, pose, CAMERA))
    return made


def of(hits: float = 0.0, miss: float = 1.0, crossed: bool = False) -> float:
    """The occupancy of one voxel, with a hit gain of 5."""
    solidity, chance = np.full((1, 1, 1), 5 * hits, np.int16), np.full((1, 1, 1), miss, np.float32)
    return float(occupancy(solidity, chance, np.full((1, 1, 1), crossed), 5)[0, 0, 0])


def test_the_formula_by_hand() -> None:
    assert of() == 0.5
    assert of(hits=1) == pytest.approx(0.7)  # one hit of OctoMap
    assert of(hits=2) == pytest.approx(0.49 / (0.49 + 0.09))
    assert 0.5 < of(hits=0.2) < of(hits=1)  # four of five views went through it
    assert of(hits=10) == pytest.approx(0.97)  # its upper bound
    assert of(crossed=True) == pytest.approx(0.05)
    assert of(crossed=True, miss=0.5) == of(miss=0.5) == pytest.approx(0.5 / 99 / (1 + 0.5 / 99))
    assert of(miss=0.0) == 0.0


def test_it_agrees_with_the_states(volume: VoxelVolume) -> None:
    found, states = volume.occupancy, volume.states
    assert {UNKNOWN, FREE, OCCUPIED} == set(np.unique(states))
    assert found.dtype == np.float32 and found.min() >= 0.0 and found.max() <= 1.0
    assert ((found > 0.5) == (states == OCCUPIED)).all()
    assert found[states == FREE].max() < 0.01 * volume.config.max_miss_chance / 0.9
    unseen = volume.unobserved
    assert (found[unseen] == 0.5).mean() > 0.99
    assert found[(states == UNKNOWN) & ~unseen].max() == pytest.approx(0.05)
    assert (VoxelVolume(ROOM).occupancy == 0.5).all()


def test_it_follows_a_change_and_cannot_be_written(volume: VoxelVolume) -> None:
    fresh = VoxelVolume(ROOM)
    assert fresh.occupancy_at(np.array([[2.0, 1.5, 1.2]]))[0] == 0.5
    fresh.mark_free_sphere(np.array([2.0, 1.5, 1.2]), 0.4)
    inside_and_outside = np.array([[2.0, 1.5, 1.2], [99.0, 0.0, 0.0]])
    np.testing.assert_array_equal(fresh.occupancy_at(inside_and_outside), [0.0, 0.5])
    np.testing.assert_array_equal(fresh.state_at(inside_and_outside), [FREE, UNKNOWN])
    for array in (volume.occupancy, volume.states):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0, 0] = 1
    volume.state[0, 0, 0] = volume.state[0, 0, 0]  # the volume itself still can
