"""Programs that share a directory: every job exactly once, jobs of a killed one by the others."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import StandardProtocol, open_comparison
from activestructure_gym.evaluation.archive import plugin_code
from activestructure_gym.evaluation.archive.claims import LOST_AFTER
from activestructure_gym.evaluation.archive.directory_lock import hold
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.running.api import NullListener
from activestructure_gym.evaluation.running.comparison import Result, run_comparison
from activestructure_gym.evaluation.running.engines import ENGINES, Engine, Limits, Outcome
from activestructure_gym.evaluation.running.episode import run_job
from activestructure_gym.evaluation.running.sharding import Shard, run_shard

ROOT = Path(__file__).resolve().parents[3]
SMALL = replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=1000)
OVERRIDES = (("mapper.iterations", 1), ("sensor.height", 36), ("sensor.width", 64))


def jobs(number: int, policy: str = "random") -> list[Job]:
    return [
        Job("box", policy, seed, preset="fast", frame_budget=6, overrides=OVERRIDES, protocol=SMALL)
        for seed in range(number)
    ]


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Engine ``counted``: as ``inline``, and keeps how often it ran which job; seed 3 fails."""
    ran = Counter[str]()

    def run(these: Sequence[Job], directory: Path, listener: Any, limits: Limits, **_: Any) -> list[Outcome]:
        outcomes = []
        for job in these:
            ran[job.name] += 1
            if job.seed != 3:
                run_job(job, directory / "jobs" / job.name)
            outcomes.append(Outcome(job, "it would not" if job.seed == 3 else None))
            listener.ended(outcomes[-1])
        return outcomes

    monkeypatch.setitem(ENGINES, "counted", Engine(run, slots=lambda jobs, limits: 1, check=lambda limits: None))  # type: ignore[arg-type]
    return ran


def test_two_shards_play_every_job_once_and_one_reports(tmp_path: Path, counted: Counter[str]) -> None:
    results: dict[int, tuple[Result, bool]] = {}

    def play(number: int) -> None:
        results[number] = run_shard(jobs(5), tmp_path, NullListener(), Shard(number, 2), engine="counted")

    threads = [threading.Thread(target=play, args=(number,)) for number in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(counted.values()) == [1] * 5
    for result, _ in results.values():
        assert [run.job.seed for run in result.runs] == [0, 1, 2, 4]
        assert [(one.job.seed, one.error) for one in result.failed] == [(3, "it would not")]
    assert sorted(reports for _, reports in results.values()) == [False, True]
    # What failed is left alone, until it is asked for again.
    run_shard(jobs(5), tmp_path, NullListener(), Shard(1, 1), engine="counted")
    assert sum(counted.values()) == 5
    run_shard(jobs(5), tmp_path, NullListener(), Shard(1, 1), engine="counted", again=True)
    assert sum(counted.values()) == 6
    # Nothing is new, and the report is there; once it is mended, somebody reports again.
    assert not run_shard(jobs(5), tmp_path, NullListener(), Shard(2, 2), engine="counted")[1]
    run_job(jobs(5)[3], tmp_path / "jobs" / jobs(5)[3].name)
    assert run_shard(jobs(5), tmp_path, NullListener(), Shard(2, 2), engine="counted")[1]
    shutil.rmtree(tmp_path / "jobs" / jobs(5)[3].name)
    # It is a comparison like any other.
    result = run_comparison(jobs(6), tmp_path, NullListener(), engine="counted", resume=True)
    assert len(result.runs) == 5 and len(open_comparison(tmp_path)) == 5


def test_shards_play_again_what_changed_own_code_played_if_asked_to(
    tmp_path: Path, counted: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    file, runs, told = tmp_path / "mine_shared.py", tmp_path / "runs", list[str]()
    runs.mkdir()
    file.write_text("from activestructure_gym.policies.random import Random as Mine\n")
    mine = jobs(2, "mine_shared:Mine")

    def play(*, again: bool) -> tuple[int, bool]:
        told.clear()
        plugin_code.first_sum_of.cache_clear()  # as in another process
        _, reports = run_shard(mine, runs, NullListener(), Shard(1, 1), engine="counted", again=again, tell=told.append)
        return sum(counted.values()), reports

    assert play(again=True) == (2, True)
    file.write_text(file.read_text() + "# thought about\n")
    assert play(again=False) == (2, False)
    assert told == ["2 runs with policy mine_shared:Mine stay, though its code has changed since"]
    assert play(again=True) == (4, True)  # the report of before is of the other text
    assert told == ["2 runs with policy mine_shared:Mine are played again: its code has changed since"]
    assert play(again=True) == (4, False) and not told


def test_a_shard_begins_with_its_own_and_helps_with_all() -> None:
    assert Shard(1, 2).order(jobs(5)) == [jobs(5)[n] for n in (0, 2, 4, 1, 3)]
    assert Shard(3, 3).order(jobs(4)) == [jobs(4)[n] for n in (2, 0, 3, 1)]
    assert Shard(9, 9).order(jobs(2)) == jobs(2)
    for text in ("0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"):
        with pytest.raises(InputError, match="--shard is a number of how many"):
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


@pytest.mark.slow
def test_the_jobs_of_a_killed_shard_are_taken_over(tmp_path: Path) -> None:
    words = (
        "compare --scenes box --policies random --seeds 0,1,2,3,4,5 --preset fast --frames 40 --views 1 --samples 1000"
    )
    command = [sys.executable, "-m", "activestructure_gym.evaluation.cli", *words.split()]
    command += ["--workers", "1", "--out", str(tmp_path / "runs")]
    given: dict[str, Any] = {
        "cwd": ROOT, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True,
        "env": {**os.environ, LOST_AFTER: "6", "PYTHONPATH": str(ROOT)},
    }  # fmt: skip
    first = subprocess.Popen([*command, "--shard", "1/2"], start_new_session=True, **given)
    claims = tmp_path / "runs" / "claims"
    end = time.monotonic() + 120
    while not list(claims.glob("*.0")):
        assert first.poll() is None and time.monotonic() < end
        time.sleep(0.05)
    (claimed,) = claims.glob("*.0")
    os.killpg(first.pid, signal.SIGKILL)
    first.communicate()
    assert claimed.exists()  # nobody gave it back
    second = subprocess.run([*command, "--shard", "2/2"], timeout=300, check=False, **given)
    assert second.returncode == 0, second.stdout
    runs = open_comparison(tmp_path / "runs")
    assert [run.job.seed for run in runs] == [0, 1, 2, 3, 4, 5]
    assert (tmp_path / "runs" / "report.html").is_file() and not list(claims.glob("*.[0-9]"))
