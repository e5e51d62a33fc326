"""Run any policy on any scene, step by step, with the same loop as `asg compare`.

    python examples/00_play.py --policy "active_gs?travel=shared" --scene "apartment?rooms=2" --picture last.png

The environment computes the features that the policy requires, and the policy finds their columns by name. You can copy
this file and change the loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from PIL import Image

from activestructure_gym.policies import make_env_and_policy


@dataclass
class Args:
    """Hold the command-line options."""

    policy: str = "hole_area"
    """A name with its options, package.module:Class, or learned:CHECKPOINT."""
    scene: str = "room"
    """A name with its options, a mesh file, or a folder of Replica or Matterport3D."""
    preset: str = "fast"
    frames: int | None = None
    """Frame budget of the episode; the preset's if not given."""
    seed: int = 0
    picture: Path | None = None
    """File for an image of the last step: camera, map and plan."""


def main(args: Args) -> list[int]:
    """Play one episode, and return the rows of the candidate table that the policy has chosen."""
    env, policy = make_env_and_policy(
        args.policy, args.scene, preset=args.preset, frame_budget=args.frames, render_mode="rgb_array"
    )
    policy.reset(args.seed)
    observation, info = env.reset(seed=args.seed)
    rows, ended = list[int](), not observation["action_mask"].any()
    while not ended:
        rows.append(policy.act(observation))
        observation, reward, terminated, truncated, info = env.step(rows[-1])
        ended = terminated or truncated
        print(f"frame {info['frames']}: view {rows[-1]}, reward {float(reward):.2f}, {policy.trace()}", flush=True)
    print(f"{info['gaussians']} Gaussians and {info['planes']} planes after {info['metres']:.1f} m")
    if args.picture is not None:
        Image.fromarray(env.render()).save(args.picture)  # type: ignore[arg-type]
    env.close()
    return rows


if __name__ == "__main__":
    main(tyro.cli(Args))
