"""Steps and turns of a trajectory by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.evaluation.trajectories.motion import motion_report
from activestructure_gym.geometry import look_along


def test_what_is_over_the_limits_is_counted() -> None:
    places = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.4, 0, 0], [0.4, 0, 0]])
    yaws = np.radians([0.0, 10.0, 10.0, 50.0])
    poses = np.stack([look_along(p, np.array([np.cos(a), np.sin(a), 0.0])) for p, a in zip(places, yaws)])
    told = motion_report(poses, max_step_m=0.1, max_turn_deg=10.0)
    assert told["largest_step_m"] == pytest.approx(0.3) and told["largest_turn_deg"] == pytest.approx(40.0)
    assert (told["steps_too_long"], told["turns_too_wide"]) == (1, 1)
    assert motion_report(poses[:1], max_step_m=0.1, max_turn_deg=10.0)["largest_step_m"] == 0.0
