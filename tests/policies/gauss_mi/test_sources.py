"""GauSS-MI's 94 moves, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from activestructure_gym.geometry import look_along
from activestructure_gym.policies.gauss_mi.sources import Moves, moves


def context(pose: np.ndarray, stops: np.ndarray, blocked: float = np.inf) -> Any:
    """Places with x below ``blocked`` can be reached."""
    far = SimpleNamespace(at=lambda places: np.where(places[:, 0] < blocked, 0.0, np.inf))
    clear = SimpleNamespace(clearance_at=lambda places: np.ones(len(places)))
    agent = SimpleNamespace(pose=pose, stops=stops, distances=far)
    return cast(Any, SimpleNamespace(agent=agent, volume=clear, clearance_m=0.2))


def test_there_are_94_moves_and_none_is_a_mere_turn() -> None:
    made = moves()
    assert len(np.unique(made, axis=0)) == len(made) == 94
    assert np.linalg.norm(made[:, :2], axis=1).min() == pytest.approx(0.3)
    assert np.linalg.norm(made[:, :2], axis=1).max() == pytest.approx(1.2 * np.sqrt(2))


def test_a_step_is_to_the_side_of_the_new_view_direction() -> None:
    pose = look_along(np.array([1.0, 2.0, 1.5]), np.array([0.0, 1.0, 0.0]))
    views = Moves().propose(context(pose, pose[None])).world_from_camera
    steps, ahead = views[:, :3, 3] - pose[:3, 3], views[:, :3, 2]
    assert np.abs((steps * ahead).sum(axis=1)).max() < 1e-9 and np.abs(ahead[:, 2]).max() < 1e-9
    # 0.3 m to the left without a turn is towards -x; after a turn of 40 degrees to the left, the step turns too.
    wanted = moves() == [0.3, 0.0, 0.0]
    np.testing.assert_allclose(steps[wanted.all(axis=1)], [[-0.3, 0.0, 0.0]], atol=1e-9)
    turned = np.isclose(moves(), [0.3, 0.0, np.radians(40.0)]).all(axis=1)
    angle = np.radians(90.0 + 40.0)
    np.testing.assert_allclose(steps[turned], [[-0.3 * np.sin(angle), 0.3 * np.cos(angle), 0.0]], atol=1e-9)


def test_at_a_dead_end_the_view_before_the_last_is_proposed() -> None:
    pose = look_along(np.array([1.0, 2.0, 1.5]), np.array([0.0, 1.0, 0.0]))
    earlier = look_along(np.array([0.4, 2.0, 1.5]), np.array([0.0, 1.0, 0.0]))
    stops = np.stack([earlier, pose])
    open_ = Moves().propose(context(pose, stops, blocked=1.01)).world_from_camera
    assert 0 < len(open_) < 94 and open_[:, 0, 3].max() < 1.01
    np.testing.assert_array_equal(Moves().propose(context(pose, stops, blocked=-1.0)).world_from_camera, [earlier])
