"""SIGKILL at random moments, to the supervisor or to a worker; then resume. The result is that of a run in peace.

Four kills unless the environment says otherwise:

    ASG_KILLS=20 python -m pytest -m slow -s tests/evaluation/running/engines/test_kills.py
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from activestructure_gym.evaluation.archive.completion import DONE, JOBS
from activestructure_gym.evaluation.archive.store import COMPARISON

KILLS, SEED = int(os.environ.get("ASG_KILLS", "4")), int(os.environ.get("ASG_KILL_SEED", "0"))
GRID = "--scenes box --policies random,pixel_only --seeds 0,1,2 --preset fast --frames 25 --views 3".split()
SAME = ("metrics.json", "steps.jsonl", "config.json")  # to the last byte; timing.json holds the clock

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks processes up in /proc"),
]


@pytest.fixture
def started(tmp_path, monkeypatch):
    """Starts ``asg compare``; what is still running at the end is ended."""
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.getcwd(), *(path for path in sys.path if path)]))
    processes = []

    def start(out: Path) -> subprocess.Popen:
        # A kill before there is a record leaves nothing to resume: then it is begun again, by the same command.
        words = ["--resume"] if (out / COMPARISON).is_file() else GRID
        command = [sys.executable, "-m", "activestructure_gym.evaluation.cli", "compare", "--out", str(out), *words]
        with open(tmp_path / "said.txt", "ab") as said:
            processes.append(subprocess.Popen(command, stdout=said, stderr=said, cwd=tmp_path))
        return processes[-1]

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.wait()


def test_after_random_kills_every_job_is_there_once_with_the_numbers_of_an_undisturbed_run(started, tmp_path):
    chance, began = random.Random(SEED), time.monotonic()
    peaceful = tmp_path / "peaceful"
    supervisor = started(peaceful)
    assert supervisor.wait(600) == 0, (tmp_path / "said.txt").read_text()
    length = time.monotonic() - began
    expected = {path.name: [(path / name).read_bytes() for name in SAME] for path in (peaceful / JOBS).iterdir()}
    assert len(expected) == 6
    say(f"undisturbed: {len(expected)} jobs in {length:.1f} s; then {KILLS} kills, random seed {SEED}")

    kills, grid, victims, orphans = 0, 0, {"supervisor": 0, "worker": 0}, set[int]()
    met = set[int]()  # workers that were there to be killed
    while True:
        grid += 1
        out, stamps, sittings, code = tmp_path / f"grid{grid}", dict[str, int](), 0, None
        while code != 0:
            sittings += 1
            supervisor, code = started(out), None
            sitting = time.monotonic()
            while code is None:
                # Two of three while jobs run, the others from the start on, when scenes are prepared.
                wait = kills < KILLS and chance.random() < 2 / 3
                while wait and supervisor.poll() is None and not workers_of(supervisor):
                    time.sleep(0.1)
                moment = chance.uniform(0, 0.4 * length) if kills < KILLS else 600.0
                try:
                    code = supervisor.wait(moment)
                    break
                except subprocess.TimeoutExpired:
                    assert kills < KILLS, "a run that nobody disturbs does not end"
                workers = workers_of(supervisor)
                met.update(workers)
                victim = chance.choice(("supervisor", "worker")) if workers else "supervisor"
                try:
                    os.kill(supervisor.pid if victim == "supervisor" else chance.choice(workers), signal.SIGKILL)
                except ProcessLookupError:
                    continue  # it has just ended by itself
                if victim == "supervisor":
                    code = supervisor.wait()
                    if code != -signal.SIGKILL:
                        continue
                    orphans.update(workers)
                kills += 1
                victims[victim] += 1
                done = check_finished(out, expected, stamps)
                say(
                    f"kill {kills:2d}: {victim:10s} {time.monotonic() - sitting:5.1f} s into sitting {sittings} "
                    f"of grid {grid}, {len(workers)} workers running, {done} of {len(expected)} jobs finished"
                )
            assert code in (0, 1, -signal.SIGKILL), (tmp_path / "said.txt").read_text()
        assert check_finished(out, expected, stamps) == len(expected)
        assert {path.name for path in (out / JOBS).iterdir()} == set(expected)  # each once, and nothing half-written
        assert set(json.loads((out / COMPARISON).read_text())["jobs"]) == set(expected)
        assert len((out / "results.csv").read_text().splitlines()) == 1 + len(expected)
        say(f"grid {grid}: complete after {sittings} sittings, all {len(expected)} jobs once, all numbers the same")
        if kills >= KILLS:
            break
    assert met, "no worker was ever found: what are they called now?"
    deadline = time.monotonic() + 15
    while any(words_of(orphan) for orphan in orphans) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not [orphan for orphan in orphans if "evaluation.running.worker" in words_of(orphan)]
    say(f"killed in {grid} grids: {victims['supervisor']} supervisors, {victims['worker']} workers; no process is left")


def check_finished(out: Path, expected: dict[str, list[bytes]], stamps: dict[str, int]) -> int:
    """All that counts as finished is whole, right, and what it was at the last look; returns how many there are."""
    finished = [mark.parent for mark in out.glob(f"{JOBS}/*/{DONE}") if not mark.parent.name.startswith(".")]
    for path in finished:
        assert [(path / name).read_bytes() for name in SAME] == expected[path.name]
        assert stamps.setdefault(path.name, (path / DONE).stat().st_mtime_ns) == (path / DONE).stat().st_mtime_ns
    assert set(stamps) == {path.name for path in finished}
    return len(finished)


def workers_of(supervisor: subprocess.Popen) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            if int(stat.read_text().rpartition(")")[2].split()[1]) == supervisor.pid:
                found.append(int(stat.parent.name))
        except OSError:
            continue
    return [process for process in found if "evaluation.running.worker" in words_of(process)]


def words_of(process: int) -> str:
    """The command line of a living process; empty for any other."""
    try:
        return Path(f"/proc/{process}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def say(text: str) -> None:
    print(text, flush=True)
