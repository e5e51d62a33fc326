"""NARUTO's two stages by hand: goals by score, then the look-at list by rotation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.geometry import look_along
from activestructure_gym.policies.candidates import Candidates
from activestructure_gym.policies.naruto import Naruto
from activestructure_gym.policies.naruto.policy import AT_GOAL, faced, forward
from activestructure_gym.sources import make_source
from tests.policies.binding import bound

X, Y, Z = np.eye(3)
HERE = np.zeros(3)


def observation(
    rows: list[tuple], *, lists: dict[int, list] | None = None, pose: np.ndarray = HERE, turn_deg: float = 0.0,
    frames: list | None = None, revisit: tuple[int, ...] = (),
) -> dict[str, np.ndarray]:  # fmt: skip
    """Rows of (position, direction, score); ``lists`` of targets by row; the camera looks along x, turned about z."""
    count = len(rows)
    candidates = np.zeros((count + 1, len(CANDIDATE_COLUMNS)), np.float32)
    features = np.zeros((count + 1, 1 + 30), np.float32)
    for k, (position, direction, score) in enumerate(rows):
        candidates[k, :3], candidates[k, 3:6] = position, np.asarray(direction) / np.linalg.norm(direction)
        features[k, 0] = score
        listed = np.tile(np.asarray(position, float), (10, 1))
        for rank, target in enumerate((lists or {}).get(k, [])):
            listed[rank] = target
        features[k, 1:] = listed.ravel()
    candidates[:count, CANDIDATE_COLUMNS.index("frames")] = frames or [5.0] * count
    candidates[list(revisit), CANDIDATE_COLUMNS.index("revisit")] = 1.0
    # The camera's z axis along x is a turn of 90 degrees about y; then the turn about the world's z.
    half = np.radians(turn_deg) / 2
    a, b = np.array([np.cos(half), 0, 0, np.sin(half)]), np.array([np.sqrt(0.5), 0, np.sqrt(0.5), 0])
    w = a[0] * b[0] - a[1:] @ b[1:]
    quaternion = np.concatenate([[w], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])
    return {
        "candidates": candidates,
        "candidate_features": features,
        "action_mask": (np.arange(count + 1) < count).astype(np.int8),
        "pose": np.concatenate([pose, quaternion]).astype(np.float32),
    }


def test_forward_is_the_z_axis_of_the_orientation(rng: np.random.Generator) -> None:
    np.testing.assert_allclose(forward(observation([(X, Y, 1.0)])["pose"][3:]), X, atol=1e-6)
    np.testing.assert_allclose(forward(observation([(X, Y, 1.0)], turn_deg=90.0)["pose"][3:]), Y, atol=1e-6)
    from scipy.spatial.transform import Rotation

    for rotation in Rotation.random(5, random_state=1):
        np.testing.assert_allclose(forward(rotation.as_quat(scalar_first=True)), rotation.as_matrix()[:, 2], atol=1e-12)


def test_a_target_is_looked_at_within_25_degrees() -> None:
    observed = observation([(HERE, X, 0.0)])
    angles = np.radians([0.0, 24.0, 26.0, 90.0, 180.0])
    targets = np.stack([np.cos(angles), np.sin(angles), np.zeros(5)], axis=1)
    np.testing.assert_array_equal(faced(Candidates(observed), targets)[0], [True, True, False, False, False])


def test_turns_of_the_native_setup_face_nearly_every_target(rng: np.random.Generator) -> None:
    stages = Naruto.native_settings.stages or ()
    turns = [make_source(name) for name in stages[0] if name.startswith("turns")]
    context = cast(Any, SimpleNamespace(agent=SimpleNamespace(pose=look_along(HERE, X))))
    poses = np.concatenate([turn.propose(context).world_from_camera for turn in turns])
    observed = observation([(HERE, direction, 0.0) for direction in poses[:, :3, 2]])
    targets = rng.normal(size=(5000, 3))
    targets /= np.linalg.norm(targets, axis=1, keepdims=True)
    assert faced(Candidates(observed), targets).any(axis=0).mean() > 0.98  # level turns alone: 36 %
    assert Naruto.native_settings.candidates == 128 + len(poses)


def test_the_goal_is_the_best_score_whatever_the_way() -> None:
    rows = [(X, X, 0.5), (9 * X, X, 0.6), (Y, X, 0.1)]
    observed = observation(rows, frames=[1.0, 90.0, 1.0])
    assert bound(Naruto()).act(observed) == 1
    assert bound(Naruto(travel="shared")).act(observed) == 0
    assert bound(Naruto()).act(observation(rows, revisit=(1,))) == 0


def test_at_the_goal_the_first_target_of_its_list_decides_the_direction() -> None:
    goal = 5 * X
    rows = [
        (goal, -X, 3.0),  # the goal
        (goal + 0.5 * Y, Y, 2.0),  # looks at the second target
        (goal + 0.5 * Z, X, 1.0),  # looks at the first one
        (goal + (AT_GOAL + 0.1) * Y, X, 1.0),  # so does this, but elsewhere
    ]
    first, second = goal + 1.5 * X, goal + 1.6 * Y
    policy = bound(Naruto())
    assert policy.act(observation(rows, lists={0: [first, second]})) == 2
    assert policy.trace() == {"stage": "goal", "naruto": 1.0, "looked_at": 1, "left": 1}
    # Nobody looks at the first: the one that looks at another; nobody looks at any: the goal as it comes.
    assert bound(Naruto()).act(observation([rows[0], rows[1]], lists={0: [first, second]})) == 1
    assert bound(Naruto()).act(observation([rows[0], rows[3]], lists={0: [first, second]})) == 0


def test_the_list_is_looked_through_by_the_smallest_rotation_then_a_new_goal_is_chosen() -> None:
    goal = 5 * X
    ahead, left, right = goal + 1.5 * X, goal + 1.5 * Y, goal - 1.5 * Y
    turned = np.array([np.cos(np.radians(80)), np.sin(np.radians(80)), 0])
    rows = [
        (goal, X, 3.0),
        (goal, turned, 3.0),  # sees left, 80 degrees away
        (goal, -Y, 3.0),  # sees right, 90 degrees away
        (goal, -X, 3.0),  # sees nothing on the list
        (9 * Y, X, 9.0),
    ]
    policy = bound(Naruto())
    lists = {0: [ahead, right, left], 4: []}
    # The row with the score 9 is no goal yet.
    begin = observation(rows[:4], lists=lists)
    assert policy.act(begin) == 0
    assert policy.trace()["left"] == 2
    there = observation(rows, lists=lists, pose=goal)
    assert policy.act(there) == 1
    assert policy.trace() == {"stage": "look", "naruto": 3.0, "looked_at": 1, "left": 1}
    assert policy.act(observation(rows, lists=lists, pose=goal, turn_deg=80.0)) == 2
    assert policy.trace()["left"] == 0
    assert policy.act(observation(rows, lists=lists, pose=goal, turn_deg=-90.0)) == 4
    assert policy.trace()["stage"] == "goal"


def test_what_one_look_shows_needs_no_other() -> None:
    goal = 5 * X
    policy = bound(Naruto())
    rows = [(goal, X, 3.0), (goal, Y, 3.0)]
    policy.act(observation(rows, lists={0: [goal + X, goal + 1.5 * X + 0.1 * Y, goal + X + 0.2 * Z]}))
    assert policy.trace() == {"stage": "goal", "naruto": 3.0, "looked_at": 3, "left": 0}


def test_a_goal_that_was_not_reached_is_given_up_with_its_list() -> None:
    goal = 5 * X
    rows = [(goal, X, 3.0), (goal, Y, 3.0), (Y, X, 4.0)]
    policy = bound(Naruto())
    policy.act(observation(rows[:2], lists={0: [goal + X, goal + Y]}))
    assert policy.trace()["left"] == 1
    assert policy.act(observation(rows, pose=goal - (AT_GOAL + 0.1) * X)) == 2
    assert policy.trace()["stage"] == "goal"


def test_reset_forgets_the_list() -> None:
    goal = 0.5 * X
    rows = [(goal, X, 3.0), (goal, Y, 1.0)]
    policy = bound(Naruto())
    policy.act(observation(rows, lists={0: [goal + X, goal + Y]}))
    policy.reset(1)
    assert policy.act(observation(rows)) == 0
    assert policy.trace()["stage"] == "goal"


@pytest.mark.parametrize("travel", ["native", "shared"])
def test_without_a_target_in_reach_of_anything_it_is_the_nearest(travel: str) -> None:
    observed = observation([(X, X, 0.0), (Y, X, 0.0), (Z, X, 0.0)], frames=[9.0, 2.0, 5.0])
    assert bound(Naruto(travel)).act(observed) == 1
    observed["candidates"][1, CANDIDATE_COLUMNS.index("revisit")] = 1.0
    assert bound(Naruto(travel)).act(observed) == 2


def test_in_the_native_setup_it_turns_in_place_and_looks_at_a_target_on_the_way() -> None:
    from activestructure_gym.policies import make_env_and_policy

    small = {"sensor": {"width": 64, "height": 36}, "mapper.iterations": 1}
    env, policy = make_env_and_policy("naruto", "box", setup="native", preset="fast", frame_budget=60, config=small)
    observation, _ = env.reset(seed=1)
    policy.reset(1)
    turned = walked = 0
    for _ in range(40):
        rows = policy.candidates(observation)
        facing = rows.valid & rows.source("targets?rows=128")
        # Every one of them faces a target from its end, and from all of its way.
        aim = rows.fixation_point[facing] - rows.xyz[facing]
        cosine = (aim * rows.view_direction[facing]).sum(axis=1) / np.linalg.norm(aim, axis=1)
        assert (cosine > 0.999).all()
        choice = policy.act(observation)
        in_place = np.linalg.norm(rows.xyz[choice] - observation["pose"][:3]) < 1e-3
        turned += in_place and policy.trace()["looked_at"] > 0
        walked += facing[choice] and not in_place
        observation, _, terminated, truncated, _ = env.step(choice)
        if terminated or truncated:
            break
    assert turned >= 2 and walked >= 1
    env.close()
