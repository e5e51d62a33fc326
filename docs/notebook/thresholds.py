"""Print the table of native.md, "Thresholds that are guesses": the effect of halving and doubling each threshold.

    python docs/notebook/thresholds.py gs_planner
    python docs/notebook/thresholds.py hgs_planner

Every variant of a planner plays four episodes, on two scenes with two seeds, with 150 frames and the preset
``default``. The result is the newly observed share of the surface, in percent. One planner takes about six minutes on
an idle machine with two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import ModuleType
from unittest import mock

import activestructure_gym.features.information as information
import activestructure_gym.policies.gs_planner.features as gains
import activestructure_gym.policies.gs_planner.policy as gs
import activestructure_gym.policies.hgs_planner.policy as hgs
from activestructure_gym.envs.reward import RewardConfig
from activestructure_gym.policies import make_env_and_policy

SCENES, SEEDS, FRAMES = ("room?seed=22", "apartment?rooms=2&seed=21"), (0, 1), 150
GUESSES: Mapping[str, Mapping[str, tuple[ModuleType, str]]] = {
    "gs_planner": {
        "weight of the loss": (gs, "QUALITY_WEIGHT"),
        "of a full error of colour in it, metres": (gains, "COLOUR_WEIGHT"),
        "least gain of a near view": (gs, "MIN_GAIN"),
        "viewpoints of one growth": (gs, "VIEWPOINTS"),
        "metres between them": (gs, "SPACING_M"),
        "gain that is stored": (gs, "STORED_GAIN"),
        "overlap that makes two views one": (gs, "MIN_OVERLAP"),
        "metres without overlap": (gs, "OVERLAP_M"),
        "angle without overlap, radians": (gs, "OVERLAP_RAD"),
    },
    "hgs_planner": {
        "gain worth going for": (hgs, "MIN_COVERAGE"),
        "half the local window, metres": (hgs, "LOCAL_M"),
        "side of the parts of the tour, metres": (hgs, "CUBOID_M"),
        "least G_cov that counts as the best": (information, "MIN_COVERAGE"),
        "lambda next to known space": (information, "LAMBDA"),
    },
}
VARIANTS = {"hgs_planner": {"G_cov + lambda_o G_Q without units": "hgs_planner?sum=raw"}}
Played = dict[tuple[str, int], tuple[float, list[int]]]  # by (scene, seed): newly observed share in %, chosen rows


def played(name: str) -> Played:
    """Play the four episodes of the planner ``name`` with the current values of its thresholds."""
    found: Played = {}
    for scene in SCENES:
        for seed in SEEDS:
            env, policy = make_env_and_policy(name, scene, frame_budget=FRAMES)
            observation, _ = env.reset(seed=seed)
            policy.reset(seed)
            share, rows, ended = 0.0, [], False
            while not ended:
                rows.append(int(policy.act(observation)))
                observation, _, terminated, truncated, info = env.step(rows[-1])
                share += 100.0 * info["reward/coverage"] / RewardConfig().coverage
                ended = terminated or truncated
            env.close()
            found[scene, seed] = share, rows
    return found


def row_of(name: str, words: str, usual: Played) -> str:
    """Return the table row of one threshold of a planner, with the effects of halving and doubling it.

    ``words`` is its description in `GUESSES`, and ``usual`` are the episodes with the unchanged threshold.
    """
    module, constant = GUESSES[name][words]
    value = getattr(module, constant)
    cells = [words, f"{value:.3g}"]
    for factor in (0.5, 2.0):
        with mock.patch.object(module, constant, type(value)(value * factor)):
            other = played(name)
        cells += change(other, usual)
    return "| " + " | ".join(cells) + " |"


def change(other: Played, usual: Played) -> list[str]:
    """Compare the episodes ``other`` with the episodes ``usual``.

    Return the mean and the range of the change in the newly observed share, and the number of episodes with equal
    decisions, as texts.
    """
    moved = [other[key][0] - usual[key][0] for key in usual]
    same = sum(other[key][1] == usual[key][1] for key in usual)
    return [f"{sum(moved) / len(moved):+.1f} ({min(moved):+.1f} .. {max(moved):+.1f})", str(same)]


def main(name: str) -> None:
    """Play the episodes of the planner ``name``, and print its table row by row."""
    usual = played(name)
    shares = [share for share, _ in usual.values()]
    print(f"{name}: {sum(shares) / len(shares):.1f} points newly observed ({min(shares):.1f} to {max(shares):.1f})\n")
    print("| threshold | value | halved | same | doubled | same |\n|---|---|---|---|---|---|")
    for words in GUESSES[name]:
        print(row_of(name, words, usual), flush=True)
    for words, variant in VARIANTS.get(name, {}).items():
        moved, same = change(played(variant), usual)
        print(f"\n{words}: {moved}, the same in {same}")


if __name__ == "__main__":
    if sys.argv[1:2] not in [[name] for name in GUESSES]:
        sys.exit(f"thresholds.py: give a planner, {' or '.join(GUESSES)}")
    main(sys.argv[1])
