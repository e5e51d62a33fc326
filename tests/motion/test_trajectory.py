import math

import numpy as np
import pytest

from activestructure_gym.geometry import fibonacci_directions, look_along, rotation_angle, unrounded
from activestructure_gym.motion import MotionConfig, first_blocked, interpolate, is_level, unrounded_start
from activestructure_gym.motion.trajectory import _limit_turns, poses_at, yaw_pitch
from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume

CONFIG = MotionConfig()


def random_pose(rng, position):
    direction = rng.choice([-1.0, 1.0]) * np.array([0, 0, 1.0]) if rng.random() < 0.2 else rng.normal(size=3)
    return look_along(position, direction)


def distance_to_path(points, path):
    best = np.full(len(points), np.inf)
    for a, b in zip(path[:-1], path[1:]):
        share = np.clip(((points - a) @ (b - a)) / max(((b - a) ** 2).sum(), 1e-18), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - (a + share[:, None] * (b - a)), axis=1))
    return best


def bent_plainly(wanted, start, goal, most):
    """What `_limit_turns` does, with numpy; not so lengths, which BLAS rounds otherwise on every processor."""

    def length_of(turn):
        return math.sqrt(turn[0] * turn[0] + turn[1] * turn[1])

    def difference(to, from_):
        turn = to - from_
        turn[0] = (turn[0] + np.pi) % (2 * np.pi) - np.pi
        return turn

    def at_most(turn):
        length = length_of(turn)
        return turn if length <= most else turn * (most / length)

    angles, here = np.empty_like(wanted), start
    for n in range(len(wanted)):
        towards, home = at_most(difference(wanted[n], here)), difference(goal, here)
        budget = most * (len(wanted) - 1 - n)
        if length_of(home - towards) > budget:
            straight, low, high = at_most(home), 0.0, 1.0
            for _ in range(40):
                middle = 0.5 * (low + high)
                too_far = length_of(home - (towards + middle * (straight - towards))) > budget
                low, high = (middle, high) if too_far else (low, middle)
            towards = towards + high * (straight - towards)
        angles[n] = here = here + towards
    angles[-1] = goal
    return angles


def test_turns_are_those_of_plain_numpy_to_the_bit():
    rng, most, bent = np.random.default_rng(0), np.radians(10.0), 0
    for _ in range(150):
        start, goal = rng.uniform([-3.2, -1.2], [3.2, 1.2], (2, 2))
        turn = goal - start
        turn[0] = (turn[0] + np.pi) % (2 * np.pi) - np.pi
        frames = int(np.ceil(np.linalg.norm(turn) / most)) + int(rng.integers(1, 20))
        wanted = start + np.cumsum(rng.normal(0, 0.2, (frames, 2)), axis=0)
        expected = bent_plainly(wanted, start, goal, most)
        np.testing.assert_array_equal(_limit_turns(wanted, start, goal, most), expected)
        bent += not np.array_equal(expected, wanted)
    assert bent > 100


def test_steps_turns_ends_and_roll_over_random_paths():
    rng = np.random.default_rng(0)
    for _ in range(150):
        path = np.cumsum(rng.normal(size=(rng.integers(2, 7), 3)) * rng.choice([0.05, 0.5, 2.0]), axis=0)
        start, goal = random_pose(rng, path[0]), random_pose(rng, path[-1])
        frames = interpolate(path, start, goal, CONFIG)
        np.testing.assert_array_equal(frames[-1], goal)
        chain = np.concatenate([start[None], frames])
        steps = np.linalg.norm(np.diff(chain[:, :3, 3], axis=0), axis=1)
        assert steps.max() <= CONFIG.max_step_m + 1e-9
        assert np.degrees(rotation_angle(chain[:-1], chain[1:])).max() <= CONFIG.max_turn_deg + 1e-4
        assert distance_to_path(frames[:, :3, 3], path).max() < 1e-9
        # Every corner is a frame: the straight pieces between frames lie on the path, too.
        assert np.linalg.norm(frames[None, :, :3, 3] - path[1:, None], axis=2).min(axis=1).max() < 1e-9
        assert np.abs(frames[:, 2, 0]).max() < 1e-9 and frames[:, 2, 1].max() < 1e-9  # right level, down not up
        products = frames[:, :3, :3] @ frames[:, :3, :3].transpose(0, 2, 1)
        assert np.abs(products - np.eye(3)).max() < 1e-9
        # No frame more than the steps or the turns need (plus one per corner).
        moving = sum(np.ceil(np.linalg.norm(b - a) / 0.1 - 1e-9) for a, b in zip(path[:-1], path[1:]))
        turning = np.ceil(np.degrees(np.linalg.norm(wrapped(yaw_pitch(goal) - yaw_pitch(start)))) / 10 - 1e-9)
        assert len(frames) == max(moving, turning, 1)


def wrapped(difference):
    return np.array([(difference[0] + np.pi) % (2 * np.pi) - np.pi, difference[1]])


def interpolated_plainly(path, start, goal, config):
    """The plain formulas of `interpolate`, frame by frame, as an oracle for its bits."""
    most, first, last = np.radians(config.max_turn_deg), yaw_pitch(start), yaw_pitch(goal)
    positions, ahead, yaw = [], [], first[0]
    for a, b in zip(path[:-1], path[1:]):
        length = np.linalg.norm(b - a)
        for n in range(1, int(np.ceil(length / config.max_step_m - 1e-9)) + 1 if length >= 1e-9 else 0):
            share = n / int(np.ceil(length / config.max_step_m - 1e-9))
            positions.append(a * (1 - share) + b * share)
            heading = (b - a) / length
            level = np.hypot(heading[0], heading[1])
            yaw = np.arctan2(heading[1], heading[0]) if level > 0.1 else yaw
            most_pitch = np.radians(config.look_ahead_pitch_deg)
            ahead.append([yaw, np.clip(np.arctan2(heading[2], level), -most_pitch, most_pitch)])
    turn = wrapped(last - first)
    turns = int(np.ceil(np.linalg.norm(turn) / most - 1e-9))
    waiting = max(turns - len(positions), 0 if positions else 1)
    before = waiting // 2
    count = len(positions) + waiting
    positions = [path[0]] * before + positions + [path[-1]] * (waiting - before)
    wanted = np.array([first + n / count * turn for n in range(1, count + 1)])
    if ahead and np.linalg.norm(np.diff(path, axis=0), axis=1).sum() > config.look_ahead_above:
        wanted[before : before + len(ahead)] = ahead
        wanted[:before] = ahead[0]
    angles = _limit_turns(wanted, first, last, most)
    poses = [poses_at(position[None], *angle[:, None])[0] for position, angle in zip(positions, angles)]
    return np.array([*poses[:-1], goal])


def test_bits_equal_those_of_the_plain_formulas():
    rng = np.random.default_rng(1)
    for n in range(200):
        path = np.cumsum(rng.normal(size=(rng.integers(1, 7), 3)) * rng.choice([0.05, 0.5, 2.0]), axis=0)
        if n % 5 == 0:
            path = np.repeat(path, 2, axis=0)  # edges without length
        if n % 7 == 0:
            path[:, :2] = path[0, :2]  # vertical
        start, goal = random_pose(rng, path[0]), random_pose(rng, path[-1])
        frames = interpolate(path, start, goal, CONFIG)
        assert frames.tobytes() == interpolated_plainly(path, start, goal, CONFIG).tobytes()


def test_long_paths_look_where_they_go():
    path = np.array([[0.0, 0, 1], [6.0, 0, 1]])
    start, goal = look_along(path[0], np.array([-1.0, 0.2, 0])), look_along(path[1], np.array([0.0, -1.0, 0.5]))
    frames = interpolate(path, start, goal, CONFIG)
    assert len(frames) == 60
    np.testing.assert_allclose(frames[18:45, :3, 2], np.tile([1.0, 0, 0], (27, 1)), atol=1e-9)
    # Going back the whole way with unchanged view directions: turned around and around again.
    back = interpolate(path[::-1], look_along(path[1], [1.0, 0, 0]), look_along(path[0], [1.0, 0, 0]), CONFIG)
    assert (back[20:40, 0, 2] < -0.999).all()


def test_short_paths_turn_evenly_and_pure_turns_wait():
    start = look_along(np.zeros(3), np.array([1.0, 0, 0]))
    goal = look_along(np.array([0.0, 0.4, 0]), np.array([0.0, 1.0, 0]))
    frames = interpolate(np.array([[0.0, 0, 0], [0, 0.4, 0]]), start, goal, CONFIG)
    assert len(frames) == 9  # 90 degrees
    np.testing.assert_allclose(np.degrees(rotation_angle(frames[:-1], frames[1:])), 10.0, atol=1e-6)
    moved = np.linalg.norm(np.diff(np.concatenate([start[None], frames])[:, :3, 3], axis=0), axis=1) > 1e-9
    assert moved.tolist() == [False] * 2 + [True] * 4 + [False] * 3  # half of the waiting before, half after
    turn = interpolate(np.zeros((1, 3)), start, look_along(np.zeros(3), np.array([-1.0, 0.0, 0])), CONFIG)
    assert len(turn) == 18
    assert len(interpolate(np.zeros((1, 3)), start, start, CONFIG)) == 1  # never an empty motion


def test_a_climb_keeps_the_yaw_and_the_horizon():
    path = np.array([[0.0, 0, 0], [0.0, 0, 4.0]])
    level = np.array([0.3, 0.8, 0])
    frames = interpolate(path, look_along(path[0], level), look_along(path[1], level), CONFIG)
    yaws = np.array([yaw_pitch(f)[0] for f in frames])
    np.testing.assert_allclose(yaws, yaws[0], atol=1e-9)
    assert max(yaw_pitch(f)[1] for f in frames) == pytest.approx(np.radians(30.0), abs=1e-9)


def test_yaw_and_pitch_describe_every_level_pose():
    directions = np.vstack([fibonacci_directions(40), [[0, 0, 1.0], [0, 0, -1.0], [1e-12, 0, 1.0]]])
    for direction in directions:
        pose = look_along(np.array([1.0, 2, 3]), direction)
        again = poses_at(pose[None, :3, 3], *yaw_pitch(pose)[:, None])[0]
        np.testing.assert_allclose(again, pose, atol=1e-9)


def test_wrong_input_is_refused():
    rolled = look_along(np.zeros(3), np.array([1.0, 0, 0]))
    rolled[:3, :2] = rolled[:3, :2] @ np.array([[0.9, -np.sqrt(0.19)], [np.sqrt(0.19), 0.9]])
    level = look_along(np.zeros(3), np.array([1.0, 0, 0]))
    with pytest.raises(ValueError, match="roll"):
        interpolate(np.zeros((1, 3)), rolled, level, CONFIG)
    with pytest.raises(ValueError, match="start pose"):
        interpolate(np.ones((1, 3)), level, level, CONFIG)
    with pytest.raises(ValueError, match="max_step_m"):
        MotionConfig(max_step_m=0.0)
    with pytest.raises(ValueError, match="candidate_clearance"):
        MotionConfig(candidate_clearance=0.1)


def test_newly_seen_obstacle_blocks_the_rest_of_the_way():
    volume = VoxelVolume(np.array([[0.0, 0, 0], [6.0, 3, 2.5]]))
    volume.state[1:-1, 1:-1, 1:-1] = FREE
    path = np.array([[0.6, 1.5, 1.2], [5.4, 1.5, 1.2]])
    start, goal = look_along(path[0], np.array([1.0, 0, 0])), look_along(path[1], np.array([1.0, 0, 0]))
    frames = interpolate(path, start, goal, CONFIG)
    assert first_blocked(volume, frames, 0.2, start=start) is None
    assert first_blocked(volume, frames[:0], 0.2, start=start) is None
    volume.state[tuple(volume.voxel_of(np.array([4.05, 1.5, 1.2])))] = OCCUPIED
    volume._changed()
    stop = first_blocked(volume, frames, 0.2, start=start)
    # The voxel spans x = 4.0 to 4.1: the last good frame keeps 0.2 m to it, up to the sampling of half a voxel.
    assert stop is not None
    assert 4.0 - 0.2 - 0.1 < frames[stop - 1][0, 3] <= 4.0 - 0.2 + 1e-6
    assert first_blocked(volume, frames[stop:], 0.2, start=frames[stop - 1]) == 0
    turning = np.stack([look_along(frames[stop - 1][:3, 3], np.array([1.0, 0.1 * n, 0])) for n in range(5)])
    assert first_blocked(volume, turning, 0.2, start=frames[stop - 1]) is None


@pytest.mark.parametrize(
    "point", [(2.0, 3.0, 0.4), (1.5, 0.05, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 2.0), (-5.0, 0.0, 1.0)]
)
def test_a_point_that_is_looked_at_stays_in_the_axis_while_walking(point: tuple[float, float, float]) -> None:
    path = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0]])
    start, goal = look_along(path[0], [0.0, -1.0, 0.2]), look_along(path[-1], [-1.0, -1.0, 0.0])
    frames = interpolate(path, start, goal, CONFIG, look_at=np.array(point))
    poses = np.concatenate([start[None], frames])
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps.max() <= CONFIG.max_step_m + 1e-9
    assert np.degrees(rotation_angle(poses[1:], poses[:-1])).max() <= CONFIG.max_turn_deg + 1e-6
    np.testing.assert_allclose(frames[-1], goal, atol=1e-9)
    towards = np.array(point) - frames[:, :3, 3]
    far = np.linalg.norm(towards, axis=1)
    walking = (steps > 1e-9) & (far > 1e-2)
    cosine = (towards * frames[:, :3, 2]).sum(axis=1)[walking] / far[walking]
    assert walking.sum() >= 29 and cosine.min() > 1 - 1e-9
    assert len(interpolate(path[:1], start, start, CONFIG, look_at=path[0] + start[:3, 2])) == 1


@pytest.mark.parametrize("digits", [3, 4, 5, 8])
def test_a_level_pose_written_with_few_digits_is_level_and_close_by(digits):
    rng = np.random.default_rng(digits)
    for direction in (*rng.normal(size=(100, 3)), (0, 0, 1), (0, 0, -1), (1e-3, 2e-3, -1)):
        exact = look_along(rng.normal(size=3), np.array(direction))
        if not np.any(direction[:2]):  # straight up or down, with any yaw
            exact = poses_at(rng.normal(size=(1, 3)), rng.uniform(-3, 3, 1), np.pi / 2 * np.array(direction[2:]))[0]
        written = exact.round(digits)
        found = unrounded_start(written)
        assert is_level(found) and found[:3, 3].tobytes() == written[:3, 3].tobytes()
        np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=3e-6)
        np.testing.assert_allclose(found, written, atol=2 * 10.0**-digits)


def test_a_start_pose_that_is_exact_or_rolls_is_taken_as_it_is():
    exact = look_along(np.array([2.0, 1.5, 1.25]), np.array([0.7, 0.4, -0.3]))
    assert unrounded_start(exact).tobytes() == exact.tobytes()
    turned = exact.copy()
    cosine, sine = math.cos(0.1), math.sin(0.1)
    turned[:3, :2] = exact[:3, :2] @ np.array([[cosine, -sine], [sine, cosine]])
    np.testing.assert_array_equal(unrounded_start(turned.round(4)), unrounded(turned.round(4)))
    assert not is_level(unrounded_start(turned.round(4)))


def test_level_is_no_roll_and_not_upside_down():
    level = np.stack([look_along(np.zeros(3), d) for d in fibonacci_directions(50)])
    assert is_level(level).all()
    c, s = np.cos(0.01), np.sin(0.01)
    for turn in (np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.diag([-1.0, -1.0, 1.0])):
        rolled = level.copy()
        rolled[:, :3, :3] @= turn
        flat = np.abs(level[:, 2, 2]) < 0.9  # straight up or down any roll is as good
        assert not is_level(rolled[flat]).any()
