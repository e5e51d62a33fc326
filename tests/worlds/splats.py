"""The map of a short run in the box, as a PLY file."""

from __future__ import annotations

from pathlib import Path

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.mapping import KeyframeMapper
from activestructure_gym.mapping.ply import write_ply
from activestructure_gym.policies import make_policy

CONFIG = {"sensor.width": 64, "sensor.height": 36, "mapper.iterations": 4, "keyframe_every": 5}


def explored(env: ReconstructionEnv, policy: str) -> KeyframeMapper:
    """Play an episode and return its mapper."""
    acting = make_policy(policy)
    acting.bind(env)
    observation, _ = env.reset(seed=0)
    acting.reset(0)
    ended = False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(acting.act(observation))
        ended = terminated or truncated
    return env.reconstruction.mapper


def write_box(file: Path) -> Path:
    """Write the map of a run in the box, 4 x 3 x 2.5 m."""
    env = ReconstructionEnv(
        "box?seed=0", preset="fast", frame_budget=90, config=CONFIG, features=("hole_area",),
        start_pose=(2.0, 1.5, 1.4, 0.0),  # a given one, so that the map does not depend on the drawn starts
    )  # fmt: skip
    write_ply(explored(env, "hole_area").map, file)
    env.close()
    return file
