"""Claims: one owner at a time, taken over when he is lost, and no harm by who wakes up again."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.claims import CLAIMS, LOST_AFTER, Claims
from activestructure_gym.evaluation.archive.jobs import Job

JOBS = [Job("box[1]", "random", seed) for seed in range(5)]


def age(directory: Path, seconds: float) -> None:
    """Make all claims older."""
    for path in (directory / CLAIMS).glob("*.[0-9]*"):
        then = path.stat().st_mtime - seconds
        os.utime(path, (then, then))


def test_what_one_has_another_does_not_get_until_it_is_given_back(tmp_path: Path) -> None:
    one, other = Claims(tmp_path), Claims(tmp_path)
    assert one.take(JOBS, 2) == JOBS[:2] and other.take(JOBS, 2) == JOBS[2:4]
    assert one.take(JOBS, 9) == JOBS[4:] and other.take(JOBS, 9) == []
    one.release(JOBS[0])
    assert other.take(JOBS, 9) == [JOBS[0]]


def test_a_claim_without_signs_of_life_is_taken_over_once(tmp_path: Path) -> None:
    lost, one, other = Claims(tmp_path), Claims(tmp_path), Claims(tmp_path)
    lost.take(JOBS[:1], 1)
    age(tmp_path, one.lost_after - 5)
    assert one.take(JOBS[:1], 1) == []
    age(tmp_path, 10)
    assert one.take(JOBS[:1], 1) == JOBS[:1] and other.take(JOBS[:1], 1) == []
    lost.release(JOBS[0])  # it was only asleep: what another has is not given back
    assert other.take(JOBS[:1], 1) == []
    age(tmp_path, one.lost_after + 5)
    assert other.take(JOBS[:1], 1) == JOBS[:1]


def who_gets_it(programs: list[Claims]) -> list[int]:
    """Which of the programs got the first job when all asked at once."""
    got: list[int] = []
    start = threading.Barrier(len(programs))

    def ask(number: int) -> None:
        start.wait()
        got.extend([number] * len(programs[number].take(JOBS[:1], 1)))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(len(programs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return got


def test_of_many_that_ask_at_once_one_gets_it(tmp_path: Path) -> None:
    for _ in range(20):
        assert len(who_gets_it([Claims(tmp_path) for _ in range(8)])) == 1
        age(tmp_path, 1000.0)  # and all want to take it over in the next round


def test_signs_of_life_keep_a_claim_and_its_end_gives_it_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LOST_AFTER, "0.6")
    one, other = Claims(tmp_path), Claims(tmp_path)
    with one.alive():
        one.take(JOBS[:1], 1)
        time.sleep(1.2)
        assert other.take(JOBS[:1], 1) == []
    assert other.take(JOBS[:1], 1) == JOBS[:1]


def test_failures_are_everybodys_until_they_are_forgiven(tmp_path: Path) -> None:
    one, other = Claims(tmp_path), Claims(tmp_path)
    one.fail(JOBS[0], "the policy raised")
    other.fail(JOBS[0], "a later one")
    assert other.failure(JOBS[0]) == "the policy raised" and other.failure(JOBS[1]) is None
    other.forgive()
    assert one.failure(JOBS[0]) is None
    assert one.first("report") and not other.first("report") and other.first("another")


@pytest.mark.parametrize("given", ["0", "-3", "nan", "inf", "soon"])
def test_what_is_no_time_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str) -> None:
    monkeypatch.setenv(LOST_AFTER, given)
    with pytest.raises(InputError, match=f"ASG_LOST_AFTER is a number of seconds above 0, got '{given}'"):
        Claims(tmp_path)


def test_a_place_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / CLAIMS).touch()
    with pytest.raises(InputError, match="cannot be written"):
        Claims(tmp_path)
