from functools import partial

import numpy as np
import pytest

from activestructure_gym.motion import first_blocked_edge, path_lengths, plan_path
from activestructure_gym.motion.rrt import shorten

BOUNDS = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 2.8]])


@pytest.fixture(scope="module")
def free_room(free_volume):
    return partial(free_volume, size=BOUNDS[1])


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


@pytest.fixture(scope="module")
def divided_room(free_room):
    rng = np.random.default_rng(0)
    crates = [(c, c + [0.5, 0.5, 1.2]) for c in rng.uniform([0.3, 0.3, 0], [5, 4, 1.0], (9, 3))]
    return free_room(((3.0, -1, -1), (3.1, 3.9, 9)), *crates)


def test_free_line_is_taken_as_it_is(free_room):
    start, goal = np.array([1.0, 1.0, 1.2]), np.array([5.0, 4.0, 1.5])
    path = plan_path(free_room(), start, goal, min_clearance=0.2, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(path, [start, goal])
    assert len(plan_path(free_room(), start, start, min_clearance=0.2, rng=np.random.default_rng(0))) == 1


def test_paths_keep_the_clearance_are_short_and_depend_on_the_generator_only(divided_room):
    volume, rng = divided_room, np.random.default_rng(1)
    voxels = volume.center_of(np.argwhere(volume.clearance > 0.3))
    start = np.array([1.5, 1.0, 2.4])
    distances, tried = path_lengths(volume, start, min_clearance=0.2), 0
    for goal in voxels[rng.integers(len(voxels), size=60)]:
        if not np.isfinite(distances.at(goal))[0]:
            continue
        path = plan_path(volume, start, goal, min_clearance=0.2, rng=np.random.default_rng(7))
        np.testing.assert_array_equal(path[[0, -1]], [start, goal])
        assert first_blocked_edge(volume, path, min_clearance=0.2) is None
        assert volume.segments_free(path[:-1], path[1:], min_clearance=0.2).all()
        assert length(path) <= length(distances.path_to(goal)) + 1e-6
        again = plan_path(volume, start, goal, min_clearance=0.2, rng=np.random.default_rng(7), distances=distances)
        np.testing.assert_array_equal(path, again)
        tried += len(path) > 2
    assert tried > 10


def test_it_is_the_tree_that_finds_the_way(divided_room, monkeypatch):
    volume, start, goal = divided_room, np.array([1.5, 1.0, 2.4]), np.array([4.5, 1.0, 2.4])
    distances = path_lengths(volume, start, min_clearance=0.2)
    paths = {
        plan_path(volume, start, goal, min_clearance=0.2, rng=np.random.default_rng(n), distances=distances).tobytes()
        for n in range(5)
    }
    assert len(paths) > 1
    monkeypatch.setattr("activestructure_gym.motion.rrt._tree_path", lambda *a: None)
    fallback = plan_path(volume, start, goal, min_clearance=0.2, rng=np.random.default_rng(0), distances=distances)
    assert first_blocked_edge(volume, fallback, min_clearance=0.2) is None


def test_a_tree_that_is_too_small_falls_back_to_the_grid(divided_room):
    start, goal = np.array([1.5, 1.0, 2.4]), np.array([4.5, 1.0, 2.4])
    path = plan_path(divided_room, start, goal, min_clearance=0.2, rng=np.random.default_rng(0), max_iterations=1)
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    assert first_blocked_edge(divided_room, path, min_clearance=0.2) is None


def test_no_way_is_none(free_room):
    closed = free_room(((3.0, -1, -1), (3.1, 9, 9)))
    rng = np.random.default_rng(0)
    assert plan_path(closed, np.array([1.0, 1, 1.2]), np.array([5.0, 1, 1.2]), min_clearance=0.2, rng=rng) is None
    assert plan_path(closed, np.array([1.0, 1, 1.2]), np.array([99.0, 1, 1.2]), min_clearance=0.2, rng=rng) is None


def test_start_in_a_tight_place(free_room):
    volume = free_room(((3.0, -1, -1), (3.1, 3.9, 9)))
    start, goal = np.array([2.9, 1.0, 1.25]), np.array([4.5, 1.0, 1.2])
    path = plan_path(volume, start, goal, min_clearance=0.2, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    assert first_blocked_edge(volume, path, min_clearance=0.2) is None
    assert volume.segments_free(path[1:-1], path[2:], min_clearance=0.2).all()


def test_where_somebody_stands_he_can_turn_however_narrow_it_is(free_room):
    volume, start = free_room(), np.array([2.0, 0.12, 1.25])
    assert 0 < volume.clearance_at(start[None])[0] < 0.2
    assert path_lengths(volume, start, min_clearance=0.2).at(start[None])[0] == 0
    path = plan_path(volume, start, start, min_clearance=0.2, rng=np.random.default_rng(0))
    np.testing.assert_array_equal(path, start[None])
    beside = start + [0.05, 0, 0]
    assert plan_path(volume, start, beside, min_clearance=0.2, rng=np.random.default_rng(0)) is None


def shortened_plainly(volume, path, draws, min_clearance):
    """What `shorten` does, with numpy and one segment after the other."""

    def free(*points):
        return all(volume.segments_free(p, q, min_clearance=min_clearance)[0] for p, q in zip(points[:-1], points[1:]))

    def skipped(path):
        kept = [0]
        while kept[-1] < len(path) - 1:
            here = kept[-1]
            kept.append(max([here + 1, *(n for n in range(here + 2, len(path)) if free(path[here], path[n]))]))
        return path[kept]

    path = skipped(path)
    for pair in draws:
        if len(path) < 3:
            break
        reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        places = np.sort(pair * reached[-1])
        i, j = np.minimum(np.searchsorted(reached, places, side="right") - 1, len(path) - 2)
        if i == j:
            continue
        p, q = (
            path[n] + (path[n + 1] - path[n]) * ((s - reached[n]) / (reached[n + 1] - reached[n]))
            for n, s in zip((i, j), places)
        )
        if free(path[i], p, q, path[j + 1]):
            path = np.vstack([path[: i + 1], p, q, path[j + 1 :]])
    return skipped(path)


@pytest.mark.parametrize("seed", range(6))
def test_shortcuts_are_those_of_plain_numpy_to_the_bit(free_room, seed):
    rng = np.random.default_rng(seed)
    pillars = [((x, y, -1), (x + 0.4, y + 0.6, 9)) for x, y in rng.uniform([1.4, 0.6], [4.4, 4.0], (4, 2))]
    volume = free_room(*pillars)
    distances = path_lengths(volume, np.array([0.6, 0.6, 1.2]), min_clearance=0.2)
    places = distances.reachable
    cut = 0
    for _ in range(5):
        path = distances.path_to(places[rng.integers(len(places))])
        told = np.random.default_rng(seed).random((100, 2))
        expected = shortened_plainly(volume, path, told, 0.2)
        found = shorten(volume, path, min_clearance=0.2, rng=np.random.default_rng(seed))
        np.testing.assert_array_equal(found, expected)
        cut += len(path) - len(found)
    assert cut > 10


def test_shortening_never_lengthens_and_straightens_free_detours(free_room):
    volume, rng = free_room(), np.random.default_rng(3)
    detour = rng.uniform(BOUNDS[0] + 0.4, BOUNDS[1] - 0.4, size=(12, 3))
    np.testing.assert_array_equal(shorten(volume, detour, min_clearance=0.2, rng=rng), detour[[0, -1]])
    around = free_room(((2.5, -1, -1), (3.5, 4.0, 9)))
    path = np.array([[1.0, 0.5, 1.2], [1.0, 4.6, 1.2], [5.0, 4.6, 1.2], [5.0, 0.5, 1.2]])
    short = shorten(around, path, min_clearance=0.2, rng=rng)
    # Taut around corners (2.3, 4.2) and (3.7, 4.2): 2 * hypot(1.3, 3.7) + 1.4 = 9.24 m; 12.2 m before.
    assert 9.2 < length(short) < 9.7
