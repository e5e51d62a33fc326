"""Programs that share a directory: every job exactly once, the record whole, and one report afterwards."""

from __future__ import annotations

import json
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.running.api import NullListener
from activestructure_gym.evaluation.running.comparison import Result, run_comparison
from activestructure_gym.evaluation.running.engines import ENGINES, Engine, Limits, Outcome
from activestructure_gym.evaluation.running.record import Recording, new_record
from activestructure_gym.evaluation.running.sharding import Shard
from tests.evaluation.written_runs import write_run

JOBS = [Job("box", "random", seed, scene_hash="ab" * 32) for seed in range(5)]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Counter[int]:
    """Engine ``counted``: writes runs instead of playing them, and counts them by seed; seed 3 fails once."""
    ran = Counter[int]()

    def run(these: Sequence[Job], directory: Path, listener: Any, limits: Limits, **_: Any) -> list[Outcome]:
        outcomes = []
        for job in these:
            ran[job.seed] += 1
            failed = job.seed == 3 and ran[3] == 1
            if failed:
                listener.on_retry(job, "it would not")  # what an engine says goes through to who listens
            else:
                write_run(directory / completion.JOBS / job.name, job)
            outcomes.append(Outcome(job, "it would not" if failed else None))
            listener.ended(outcomes[-1])
        return outcomes

    engine = Engine(run, slots=lambda jobs, limits: 1, check=lambda limits: None)  # type: ignore[arg-type]
    monkeypatch.setitem(ENGINES._entries, "counted", engine)
    return ran


def test_two_shards_play_every_job_once_and_a_resumed_comparison_what_failed(tmp_path: Path, ran: Counter[int]) -> None:
    results: dict[int, Result] = {}

    def play(number: int) -> None:
        results[number] = run_comparison(JOBS, tmp_path, NullListener(), engine="counted", shard=Shard(number, 2))

    threads = [threading.Thread(target=play, args=(number,)) for number in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert ran == dict.fromkeys(range(5), 1)
    assert not results[1].failed and [one.job.seed for one in results[2].failed] == [3]
    record = json.loads((tmp_path / store.COMPARISON).read_bytes())
    assert set(record["jobs"]) == {job.name for job in JOBS}
    result = run_comparison(JOBS, tmp_path, NullListener(), engine="counted", resume=True)
    assert ran[3] == 2 and ran.total() == 6
    assert [run.job.seed for run in result.runs] == [0, 1, 2, 3, 4] and result.skipped == 4


def test_what_other_shards_have_noted_stays_in_the_record(tmp_path: Path, ran: Counter[int]) -> None:
    run_comparison(JOBS, tmp_path, NullListener(), engine="counted", shard=Shard(2, 2))
    run_comparison(JOBS, tmp_path, NullListener(), engine="counted", shard=Shard(1, 2))
    assert set(json.loads((tmp_path / store.COMPARISON).read_bytes())["failed"]) == {JOBS[3].name}


def test_jobs_that_fail_in_two_shards_at_once_are_both_in_the_record(tmp_path: Path) -> None:
    record = new_record(JOBS, None, engine="counted", slots=1, command="", asked=())
    json_files.write_json(tmp_path / store.COMPARISON, record)
    jobs = [replace(JOBS[0], seed=seed) for seed in range(40)]

    def fail(part: Sequence[Job]) -> None:
        recording = Recording(NullListener(), tmp_path, dict(record), shared=True)
        for job in part:
            recording.ended(Outcome(job, "bad"))

    threads = [threading.Thread(target=fail, args=(jobs[number::2],)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(json.loads((tmp_path / store.COMPARISON).read_bytes())["failed"]) == {job.name for job in jobs}


def test_shards_are_a_partition() -> None:
    for of in (1, 2, 3, 9):
        parts = [Shard(number, of).part(JOBS) for number in range(1, of + 1)]
        assert sorted(job.seed for part in parts for job in part) == [0, 1, 2, 3, 4]
    assert Shard(2, 3).part(JOBS) == [JOBS[1], JOBS[4]]
    assert str(Shard.parse("2/8")) == "2/8"
    for text in ("0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"):
        with pytest.raises(InputError, match="--shard is I/N with I from 1 to N"):
            Shard.parse(text)


def test_shards_let_each_other_in_and_nobody_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with hold(tmp_path, shared=True), hold(tmp_path, shared=True):
        with pytest.raises(InputError, match="is at work in"), hold(tmp_path):
            pass
    with hold(tmp_path):
        assert main(["compare", "--scenes", "box", "--out", str(tmp_path), "--shard", "1/2"]) == 2
        assert "is at work in" in capsys.readouterr().err
    assert main(["compare", "--scenes", "box", "--shard", "1/2"]) == 2
    assert "--shard needs --out" in capsys.readouterr().err
