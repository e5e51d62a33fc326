"""Test ActiveGS in the native setup: views of regions of interest, and of the half metre around the agent."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.policies import make_env_and_policy


@pytest.mark.parametrize(("name", "regions"), [("active_gs", "roi?rows=30"), ("frontier", "frontier_facing?rows=30")])
def test_its_views_are_those_of_regions_and_of_the_half_metre_around_it(name: str, regions: str) -> None:
    """Of the shared table, whose views stand all over the room, most are neither."""
    small = {"sensor": {"width": 64, "height": 36}, "mapper.iterations": 1}
    env, policy = make_env_and_policy(name, "box", setup="native", preset="fast", frame_budget=80, config=small)
    observation, info = env.reset(seed=1)
    policy.reset(1)
    most, keyframes = 0, 1
    for decision in range(1, 9):
        rows = policy.candidates(observation)
        faces, around = rows.source(regions) & rows.valid, rows.source("around?rows=70") & rows.valid
        assert (faces | around).sum() == rows.valid.sum() <= 100 and faces.sum() <= 30
        apart = np.linalg.norm(rows.xyz - observation["pose"][:3], axis=1)
        assert apart[around].max(initial=0.0) <= 0.5 + 1e-4
        most = max(most, int(faces.sum()))
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        if terminated or truncated:
            break
        keyframes = decision + 1
        assert info["keyframes"] == keyframes  # of goals alone
    assert most >= 5 and keyframes > 2
    env.close()
