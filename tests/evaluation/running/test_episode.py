"""What a run stores of an episode is what the environment offered, whatever a policy does with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from activestructure_gym.evaluation import StandardProtocol, compare
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.policies import Policy
from activestructure_gym.policies.base import best_valid

PROTOCOL = StandardProtocol(views=1, view_width=64, view_height=36, surface_samples=2000, points_source="means")


class Overwriting(Policy):
    """Use the observation as scratch memory."""

    required_features = ("hole_area",)

    def act(self, observation: dict[str, np.ndarray]) -> int:
        """Choose by the x coordinate, and clear what was read."""
        row = best_valid(observation["candidates"][:, 0] + 100.0, observation)
        for name in ("candidates", "candidate_features"):
            observation[name][:] = 0.0
        return row


def test_what_a_policy_writes_into_its_observation_is_not_stored(tmp_path: Path) -> None:
    conditions = Conditions(preset="fast", frame_budget=12, protocol=PROTOCOL)
    (run,) = compare(["box"], [f"{__name__}:Overwriting"], tmp_path, conditions=conditions, engine="inline").runs
    step = json.loads((run.directory / "steps.jsonl").read_text().splitlines()[0])
    assert step["features"]["hole_area"] > 0.0 and step["view"]["x"] > 0.0
    assert run.decisions[0][0].features["hole_area"] == np.float32(step["features"]["hole_area"])
