"""Legs of a trajectory, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.motion import recorded_segments, regular_segments, segments_at


def poses(count: int) -> np.ndarray:
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, 0, 3] = 0.1 * np.arange(count)
    return made


def test_every_fifth_frame_and_the_last_are_keyframes_of_a_bare_trajectory() -> None:
    segments = regular_segments(poses(23), keyframe_every=5)
    lengths = [len(segment.poses) for segment in segments]
    assert lengths == [19, 3], "four keyframes a segment: frames 5, 10, 15 and 20, then the last"
    factors = [0, *segments[0].refine_factors, *segments[1].refine_factors]
    assert [frame for frame, times in enumerate(factors, start=1) if times] == [5, 10, 15, 20, 23]
    np.testing.assert_array_equal(np.concatenate([segment.poses for segment in segments]), poses(23)[1:])
    assert regular_segments(poses(1), 5) == []
    assert [segment.refine_factors for segment in regular_segments(poses(2), 5)] == [(1,)]


def test_listed_poses_are_the_keyframes_and_the_rest_is_followed() -> None:
    mask = np.isin(np.arange(9), [0, 2, 3, 4, 5])
    segments = segments_at(poses(9), mask)
    assert [segment.refine_factors for segment in segments] == [(0, 1, 1, 1, 1), (0, 0, 0)]
    assert [len(segment.poses) for segment in segments_at(poses(4), np.zeros(4, dtype=bool))] == [3]


def arrays() -> dict[str, np.ndarray]:
    """A way of two frames, a frame lost, three frames in place, and a revisit with a refine factor of four."""
    return {
        "world_from_camera": poses(7),
        "keyframes": np.array([0, 2, 6]),
        "keyframe_rounds": np.array([1, 1, 4]),
        "legs": np.array([[3, 3, 0], [3, 4, 0], [6, 7, 1], [7, 8, 0]]),
    }


def test_the_legs_of_a_run_are_read_back() -> None:
    unsigned = {name: value.astype(np.uint64) for name, value in arrays().items() if name == "legs"}
    assert [segment.refine_factors for segment in recorded_segments(arrays() | unsigned)] == [
        segment.refine_factors for segment in recorded_segments(arrays())
    ]
    walk, lost, stay, revisit = recorded_segments(arrays())
    assert walk.refine_factors == (0, 1) and np.array_equal(walk.poses, poses(7)[1:3])
    assert (lost.lost, len(lost.poses)) == (1, 0)
    assert (stay.stays, len(stay.poses), stay.lost) == (3, 0, 0)
    assert revisit.refine_factors == (4,) and revisit.lost == 0


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("legs", np.array([[3, 3, 0], [2, 4, 0], [6, 7, 1], [7, 8, 0]]), "must rise"),
        ("legs", np.array([[8, 9, 0]]), "must rise to the 7 poses"),
        ("legs", np.array([[7, 5, 0]]), "a frame be paid for each"),
        ("legs", np.zeros((2, 3)), r"whole numbers \[D, 3\]"),
        ("keyframe_rounds", np.array([1, 1]), "each of 3 keyframes"),
        ("keyframes", np.array([0, 2, -1]), r"whole numbers \[K\] from 0 on"),
        ("keyframes", np.array([0.0, 2.0, 6.0]), r"whole numbers \[K\] from 0 on"),
        ("keyframes", np.array([True, False, True]), r"whole numbers \[K\] from 0 on"),
        ("keyframe_rounds", np.array([1, 1, 10**6]), "from 0 to 1000"),
    ],
)
def test_legs_that_do_not_fit_are_refused(name: str, value: np.ndarray, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        recorded_segments({**arrays(), name: value})
