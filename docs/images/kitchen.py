"""Make kitchen.webp: a film of two planners that explore the Franka kitchen in MuJoCo.

    python docs/images/kitchen.py runs/kitchen

The comparison is played into the given directory, or read from it. It needs the extra ``mujoco`` and
gymnasium-robotics.
"""

from __future__ import annotations

import sys
from pathlib import Path

from activestructure_gym.evaluation import Conditions, compare
from activestructure_gym.evaluation.replay import play_again, write_video

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "worlds"))
from mujoco_kitchen import kitchen

OUT = Path(__file__).with_name("kitchen.webp")
POLICIES, FRAMES = ["random", "activestructure"], 300


def main(folder: Path) -> None:
    """Play the episodes that are missing, replay them, and write the film."""
    world = f"{kitchen()}&width=320&height=180"
    runs = compare(
        [world], POLICIES, folder, conditions=Conditions(frame_budget=FRAMES), engine="inline", resume=folder.is_dir()
    ).runs
    write_video([play_again(run) for run in sorted(runs, key=lambda run: POLICIES.index(run.policy))], OUT)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("give the directory of the comparison: python docs/images/kitchen.py DIR")
    main(Path(sys.argv[1]))
