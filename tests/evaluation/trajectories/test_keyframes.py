"""Which poses of a trajectory are mapped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.trajectories.keyframes import every_of, listed_poses

STAMPS = np.array([10.0, 10.5, 11.0, 11.5])


def test_all_or_a_number_or_a_file() -> None:
    assert [every_of(text) for text in ("all", "1", "20", "list.txt")] == [1, 1, 20, None]
    for text in ("0", "-3"):
        with pytest.raises(InputError, match=f"must be all, a number from 1, or a file, got {text}"):
            every_of(text)


@pytest.mark.parametrize(
    ("text", "poses"), [("3\n0\n", [0, 3]), ("1 2", [1, 2]), ("10.501\n11.49\n", [1, 3]), ("# none but\n10\n", [0])]
)
def test_a_file_lists_indices_or_time_stamps(text: str, poses: list[int], tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text(text)
    assert np.flatnonzero(listed_poses(tmp_path / "list.txt", 4, STAMPS)).tolist() == poses


@pytest.mark.parametrize(
    ("text", "stamps", "said"),
    [
        ("0\n4\n", None, "not indices from 0 to 3, and the trajectory has no time stamps"),
        ("0\n1\n4\n", STAMPS, "keyframe 0.000 of .* is neither an index from 0 to 3 nor within 0.02 s"),
        ("10.2\n", STAMPS, r"keyframe 10.200 of .* time stamp \(10.000 to 11.500 s\)"),
        ("nan\n", STAMPS, "not a finite number"),
        ("first\n", STAMPS, "has a value that is not a number"),
        ("", STAMPS, "holds no pose"),
    ],
)
def test_other_lists_are_refused(text: str, stamps: np.ndarray | None, said: str, tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text(text)
    with pytest.raises(InputError, match=said):
        listed_poses(tmp_path / "list.txt", 4, stamps)
