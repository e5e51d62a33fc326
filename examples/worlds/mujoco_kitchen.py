"""Explore the Franka kitchen of Gymnasium-Robotics in MuJoCo, with any policy.

    pip install 'activestructure-gym[mujoco]' gymnasium-robotics
    python examples/worlds/mujoco_kitchen.py --policy unknown_volume --picture kitchen.png

MuJoCo renders by EGL, which Debian's packages libegl1 and libgl1 install. The kitchen has two walls and no ceiling, so
this file gives the bounds and the start pose.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

from activestructure_gym.errors import InputError
from activestructure_gym.policies import make_env_and_policy

MODEL = "envs/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml"


@dataclass
class Args:
    """Hold the command-line options."""

    policy: str = "activestructure"
    preset: str = "default"
    frames: int = 200
    seed: int = 0
    picture: Path | None = None
    """File for an image of the last step: camera, map and plan."""


def kitchen() -> str:
    """Return the name of the kitchen as a world; raise `InputError` if gymnasium-robotics is not installed."""
    found = importlib.util.find_spec("gymnasium_robotics")
    if found is None or found.origin is None:
        raise InputError("the kitchen needs the package gymnasium-robotics: pip install gymnasium-robotics")
    model = Path(found.origin).parent / MODEL
    return f"world:mujoco?model={model}&bounds=-1.6,-2.4,-0.05,2.2,1.45,3&start=1.4,-1.2,1.9,130"


def main(args: Args) -> None:
    """Play one episode in the kitchen, and print the result of each decision."""
    env, policy = make_env_and_policy(
        args.policy, kitchen(), preset=args.preset, frame_budget=args.frames, render_mode="rgb_array"
    )
    policy.reset(args.seed)
    observation, info = env.reset(seed=args.seed)
    ended = False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        ended = terminated or truncated
        print(f"frame {info['frames']}: {info['metres']:.1f} m, {reward:.1f} m³ newly known", flush=True)
    print(f"{info['gaussians']} Gaussians and {info['planes']} planes after {info['metres']:.1f} m")
    if args.picture is not None:
        Image.fromarray(env.render()).save(args.picture)  # type: ignore[arg-type]
    env.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
