"""Phase I ends at about the same share of the surface in scenes of any size."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.evaluation.protocols import CameraPath
from activestructure_gym.evaluation.protocols.visibility import seen_by_keyframes
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.policies import make_policy
from activestructure_gym.policies.activestructure import PHASES
from activestructure_gym.scenes import load_scene


@pytest.mark.slow
@pytest.mark.parametrize("rooms", [1, 3, 7])
def test_the_scaffold_is_complete_when_its_phase_ends(rooms: int) -> None:
    truth = ground_truth_of(load_scene(f"apartment?rooms={rooms}&seed=3&lit=false"))
    policy = make_policy("activestructure")
    features = policy.required_features
    env = ReconstructionEnv(scene=truth, preset="fast", frame_budget=1500, features=features, coverage_target=None)
    policy.bind(env.config.features)
    policy.reset(0)
    observation, info = env.reset(seed=0)
    while True:
        action = policy.act(observation)
        if policy.trace()["phase"] != PHASES[0].name:
            break
        observation, _, terminated, truncated, info = env.step(action)
        assert not (terminated or truncated), "phase I has not ended"
    keyframes = np.array([frame.world_from_camera for frame in env.reconstruction.mapper.keyframes])
    path = CameraPath(env.config.sensor.camera, keyframes[0], keyframes)
    points = truth.observable_surface.points[::20]
    seen = float(seen_by_keyframes(points, path, truth.scene, 2e-3).mean())
    env.close()
    print(rooms, info["frames"], round(100 * seen, 1))
    assert 0.75 < seen < 0.97
