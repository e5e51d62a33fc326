"""ANM-S's integer score and its looks, ActiveINR's one target at a time: by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.envs.observation import CANDIDATE_COLUMNS
from activestructure_gym.errors import InputError
from activestructure_gym.policies import make_policy
from activestructure_gym.policies.activeinr import ActiveINR
from activestructure_gym.policies.anm_s import AnmS
from activestructure_gym.policies.anm_s.policy import ARRIVED_M, AT_NODE, FORGET_AFTER
from activestructure_gym.policies.anm_s.targets import DEFERRED_M
from activestructure_gym.policies.base import nearest_new
from tests.policies.binding import bound, columns

X, Y, Z = np.eye(3)


def observation(rows: list[dict], names: tuple[str, ...], *, pose: np.ndarray = np.zeros(3), budget: float = 1.0):  # noqa: B008
    """Rows with ``at``, ``look``, ``path``, ``frames``, ``revisit`` and features by name; one masked row follows."""
    count = len(rows)
    candidates = np.zeros((count + 1, len(CANDIDATE_COLUMNS)), np.float32)
    features = np.zeros((count + 1, len(names)), np.float32)
    for k, row in enumerate(rows):
        path = row.get("path", 1.0)
        candidates[k] = [*row["at"], *row.get("look", X), path, row.get("frames", 10 * path), row.get("revisit", 0)]
        features[k] = [row.get(name, 0.0) for name in names]
    return {
        "candidates": candidates,
        "candidate_features": features,
        "action_mask": (np.arange(count + 1) < count).astype(np.int8),
        "pose": np.array([*pose, 1, 0, 0, 0], np.float32),
        "budget": np.array([budget], np.float32),
    }


def node(number: int, at: np.ndarray, *, unarrived=False, horizon=False, clusters=0, looks=0, facing=-1.0, **more):
    return {
        "at": at, "voronoi_node": number, "visited_distance": ARRIVED_M + (0.01 if unarrived else -0.01),
        "anm_s_horizon": float(horizon), "anm_s_clusters": clusters, "anm_s_looks": looks, "anm_s_facing": facing,
        **more,
    }  # fmt: skip


def act(policy: AnmS | ActiveINR, rows: list[dict], **options) -> int:
    return policy.act(observation(rows, columns(policy), **options))


def test_the_score_by_hand() -> None:
    policy = bound(AnmS())
    rows = [
        node(0, X, unarrived=True, horizon=True, clusters=4),
        node(1, 2 * X, unarrived=True, clusters=1),
        node(2, 3 * X, horizon=True),
        node(3, 4 * X),
        node(-1, 5 * X, unarrived=True, horizon=True, clusters=1),
    ]
    seen = policy.candidates(observation(rows, columns(policy)))
    np.testing.assert_array_equal(policy.node_score(seen)[:5], [6, 4, 2, 0, 0])
    policy._failed = np.array([[1.0, AT_NODE - 0.01], [4.0, 0.0]])
    np.testing.assert_array_equal(policy.node_score(seen)[:5], [0, 4, 2, -6, 0])


def test_the_highest_score_then_the_shortest_way() -> None:
    rows = [
        node(0, X, horizon=True, path=0.6),
        node(1, 2 * X, unarrived=True, path=9.0),
        node(2, 3 * X, unarrived=True, path=8.0),
        node(-1, Y, unarrived=True, horizon=True, path=0.1),
    ]
    assert act(bound(AnmS()), rows) == 2
    # With everybody's travel term (6 + 2) / (1 + 6 / 5) and (6 + 3) / (1 + 80 / 5).
    assert act(bound(AnmS(travel="shared")), rows) == 0
    rows[2]["revisit"] = 1
    assert act(bound(AnmS()), rows) == 1
    assert act(bound(AnmS()), [{**row, "voronoi_node": -1} for row in rows]) == 3  # no node: the nearest


def test_of_a_node_s_candidates_the_one_that_faces_something() -> None:
    rows = [
        node(0, X, unarrived=True, looks=2, facing=0.2, path=1.0),
        node(0, X + 0.4 * Y, unarrived=True, looks=2, facing=0.95, path=1.4),
        node(1, 3 * X, facing=1.0),
    ]
    policy = bound(AnmS())
    assert act(policy, rows) == 1
    assert policy.trace() == {"stage": "node", "score": 3.0, "node": 0, "looks_left": 1, "failed": 0}


def test_at_a_node_every_direction_is_looked_in_once() -> None:
    looks = [X, (X + 0.5 * Y) / np.sqrt(1.25), Y, -Y, -X]
    rows = [node(0, X, unarrived=True, looks=3, facing=0.9, look=d, frames=n + 1) for n, d in enumerate(looks)]
    rows[4]["anm_s_facing"] = 0.5  # looks at nothing
    rows.append(node(1, 5 * X, path=4.0))
    policy = bound(AnmS())
    assert act(policy, rows) == 0
    arrived = [{**row, "visited_distance": 0.0} for row in rows[:5]] + rows[5:]
    # The second is within 45 degrees of the first look; then the ones with the fewest frames; then no look is left.
    assert act(policy, arrived, pose=X) == 2
    assert act(policy, arrived, pose=X) == 3
    assert policy.trace()["looks_left"] == 0
    arrived[5] = node(1, 5 * X, unarrived=True, path=4.0)
    assert act(policy, arrived, pose=X) == 5
    assert policy.trace()["stage"] == "node"


def test_a_node_that_was_not_reached_has_failed() -> None:
    rows = [node(0, 3 * X, unarrived=True, horizon=True, looks=3, facing=1.0), node(1, 6 * X)]
    policy = bound(AnmS())
    assert act(policy, rows) == 0
    assert act(policy, rows, pose=X) == 1  # 0 against 5 - 6
    assert policy.trace()["failed"] == 1
    policy.reset(0)
    assert act(policy, rows) == 0


def test_targets_farther_than_13_m_wait_for_nodes_on_the_way() -> None:
    """The score counts before the distance to the target, and nodes that lead away from it do not count."""
    rows = [
        node(0, 20 * X, unarrived=True, horizon=True, path=DEFERRED_M + 7.0),
        node(1, 10 * X, path=10.0),
        node(2, 2 * X, unarrived=True, path=2.0),
        node(3, -2 * X, unarrived=True, horizon=True, clusters=1, path=DEFERRED_M + 9.0),
    ]
    assert act(bound(AnmS()), rows[:3]) == 2
    assert act(bound(AnmS()), rows[:2]) == 1
    assert act(bound(AnmS()), rows[2:]) == 1
    rows[0]["path"] = DEFERRED_M - 0.1
    del rows[3]
    assert act(bound(AnmS()), rows) == 0
    assert act(bound(AnmS()), [{**rows[0], "path": 20.0}]) == 0  # there is no other


def test_the_node_it_stands_at_is_no_goal_unless_there_is_no_other() -> None:
    rows = [
        node(0, 0.4 * X, unarrived=True, horizon=True, clusters=1, path=0.4),
        node(0, 0.9 * X, unarrived=True, horizon=True, clusters=1, path=0.9),  # stands for the same node
        node(1, 3 * X, path=3.0),
    ]
    assert act(bound(AnmS()), rows) == 2
    assert act(bound(AnmS()), rows[:2]) == 0
    # A look has carried it away from the stop, but it is still that node's.
    policy = bound(AnmS())
    assert act(policy, rows) == 2
    near = [node(1, 3 * X + 0.3 * Y, unarrived=True, path=0.7), node(2, 9 * X, path=6.0)]
    assert act(policy, near, pose=3 * X - 0.4 * Y) == 1


def test_pathology_of_small_integers_it_goes_to_and_fro() -> None:
    """Once all nodes are arrived at, nearly all scores are equal, and of equals the shortest way decides."""
    policy, pose, chosen = bound(AnmS()), np.zeros(3), []
    for _ in range(6):
        places = [(1.0 + n) * X for n in range(5)]
        rows = [node(n, p, clusters=1, path=float(np.linalg.norm(p - pose))) for n, p in enumerate(places)]
        chosen.append(act(policy, rows, pose=pose))
        pose = places[chosen[-1]]
    assert chosen == [0, 1, 0, 1, 0, 1]


def test_looks_stay_around_the_stop() -> None:
    """Each is within reach of the one before, but the third is not within reach of the stop."""
    rows = [node(0, X + 0.4 * n * Y, unarrived=n == 0, looks=3, facing=0.99 - 0.01 * n, look=d, path=1.0)
            for n, d in enumerate((X, Y, -X))]  # fmt: skip
    rows.append(node(1, 5 * X, path=4.0))
    policy = bound(AnmS())
    assert [act(policy, rows), act(policy, rows, pose=X), act(policy, rows, pose=X + 0.4 * Y)] == [0, 1, 3]
    assert policy.trace()["failed"] == 0


def test_failures_are_forgotten_when_there_has_been_nowhere_else_to_go() -> None:
    rows = [node(0, 3 * X, unarrived=True, path=3.0), node(1, 6 * X, path=6.0), node(2, 9 * X, path=9.0)]
    policy = bound(AnmS())
    policy._failed = np.array([[3.0, 0.0]])
    pose, chosen = np.zeros(3), []
    for _ in range(FORGET_AFTER):
        chosen.append(act(policy, rows, pose=pose))
        pose = rows[chosen[-1]]["at"]
    assert chosen == [1, 2] + [0] * (FORGET_AFTER - 2)
    assert len(policy._failed) == 0


def inr(at: np.ndarray, share: float = 0.0, target: np.ndarray | None = None, **more) -> dict:
    x, y, z = at if target is None else target
    return {"at": at, "activeinr": share, "activeinr_x": x, "activeinr_y": y, "activeinr_z": z, **more}


def test_the_largest_cluster_however_far() -> None:
    """The pathology: its size alone decides."""
    rows = [inr(X, 0.20, path=1.0), inr(9 * X, 0.21, path=30.0), inr(Y, 0.0)]
    assert act(bound(ActiveINR()), rows) == 1
    assert act(bound(ActiveINR(travel="shared")), rows) == 0
    assert act(bound(ActiveINR()), [rows[0], {**rows[1], "revisit": 1}]) == 0


def test_a_target_is_kept_until_it_is_near_or_a_hundred_frames_have_gone() -> None:
    target = np.array([5.0, 0.0, 0.0])
    rows = [inr(4 * X, 0.5, target, frames=60.0), inr(3 * X + Y, 0.0), inr(-X, 0.4, -2 * X)]
    policy = bound(ActiveINR())
    assert act(policy, rows) == 0
    assert policy.trace() == {"stage": "new target", "activeinr": 0.5, "target": [5.0, 0.0, 0.0]}
    changed = [inr(4.9 * X, 0.0, frames=40.0), inr(3 * X + Y, 0.0), inr(-X, 0.9, -2 * X)]
    # One metre away: not there yet, so the larger cluster has to wait.
    assert act(policy, changed, pose=4 * X) == 0
    assert policy.trace()["stage"] == "on the way"
    assert act(policy, changed, pose=4 * X) == 2  # after 60 and 40 frames
    assert policy.trace()["target"] == [-2.0, 0.0, 0.0]
    near = bound(ActiveINR())
    act(near, rows)
    assert act(near, changed, pose=4.3 * X) == 2


def test_nobody_stands_still() -> None:
    """In the native setup the present pose is on offer: the nearest view of all, with a target and without."""
    here = {"at": 0 * X, "path": 0.0, "frames": 1.0}
    turn = {"at": 0 * X, "path": 0.0, "frames": 5.0, "look": Y}
    for rows in ([{**here, "activeinr": 0.9}, turn], [here, {**turn, "activeinr": 0.1}]):
        assert act(bound(ActiveINR()), rows) == 1
    policy = bound(ActiveINR())
    assert act(policy, [inr(2 * X, 0.5, 3 * Y)]) == 0  # and is on the way; no view is nearer than where it stands:
    assert act(policy, [here, turn, inr(-X, 0.1, -2 * X)]) == 2 and policy.trace()["stage"] == "new target"
    assert act(policy, [here, turn, inr(-0.4 * X, 0.0)]) == 2 and policy.trace()["stage"] == "on the way"
    assert act(policy, [here, turn, inr(X, 0.0)]) == 1 and policy.trace()["stage"] == "no target"
    assert act(bound(ActiveINR()), [here]) == 0  # nothing else
    lonely = [node(0, 0 * X, path=0.0, frames=1.0), node(0, 0 * X, path=0.0, frames=5.0, look=Y)]
    assert act(bound(AnmS()), lonely) == 1 and act(bound(AnmS()), lonely[:1]) == 0
    assert nearest_new(observation([here, turn], ())) == 1


def test_without_a_cluster_the_nearest_and_no_target_is_kept() -> None:
    rows = [inr(X, frames=9.0), inr(Y, frames=3.0)]
    policy = bound(ActiveINR())
    assert act(policy, rows) == 1
    assert policy.trace() == {"stage": "no target", "activeinr": 0.0, "target": None}
    assert act(policy, [inr(X, 0.1), inr(Y, 0.0)]) == 0
    # A revisit of the present pose is the nearest of all, and taken only if there is nothing else.
    rows.append(inr(0 * X, frames=1.0, revisit=1))
    assert act(bound(ActiveINR()), rows) == 1
    assert act(bound(ActiveINR()), rows[2:]) == 0
    with_node = [node(-1, X, frames=9.0), node(-1, 0 * X, frames=1.0, revisit=1)]
    assert act(bound(AnmS()), with_node) == 0


@pytest.mark.parametrize("name", ["anm_s", "activeinr"])
def test_the_proxy_is_an_option_that_asks_for_other_gains(name: str) -> None:
    usual, proxy = make_policy(name), make_policy(f"{name}?uncertainty=proxy")
    assert any(gain.startswith(f"{name}_proxy") for gain in proxy.required_features)
    assert not any("proxy" in gain for gain in usual.required_features)
    proxy.bind(columns(proxy))
    with pytest.raises(InputError, match="option uncertainty must be perturbation or proxy, got 'guess'"):
        make_policy(f"{name}?uncertainty=guess")
