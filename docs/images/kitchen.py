"""Make kitchen.webp: a planner explores the Franka kitchen in MuJoCo, one picture per decision.

    python docs/images/kitchen.py

It needs the extra ``mujoco`` and gymnasium-robotics.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from activestructure_gym.policies import make_env_and_policy

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "worlds"))
from mujoco_kitchen import kitchen

OUT = Path(__file__).with_name("kitchen.webp")
POLICY, FRAMES, MS, WIDTH = "activestructure", 300, 350, 760


def main() -> None:
    """Play the episode and write the animation."""
    env, policy = make_env_and_policy(
        POLICY, f"{kitchen()}&width=320&height=180", preset="default", frame_budget=FRAMES, render_mode="rgb_array"
    )
    policy.reset(0)
    observation, info = env.reset(seed=0)
    panels, ended = [env.render()], False
    while not ended:
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        ended = terminated or truncated
        panels.append(env.render())
        print(f"frame {info['frames']} of {FRAMES}", flush=True)
    env.close()
    size = (WIDTH, round(WIDTH * panels[0].shape[0] / panels[0].shape[1]))  # type: ignore[union-attr]
    pictures = [Image.fromarray(panel).resize(size, Image.Resampling.LANCZOS) for panel in panels]  # type: ignore[arg-type]
    times = [MS] * (len(pictures) - 1) + [2500]
    pictures[0].save(OUT, save_all=True, append_images=pictures[1:], duration=times, loop=0, quality=60, method=6)
    print(f"{OUT}: {len(pictures)} pictures, {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
