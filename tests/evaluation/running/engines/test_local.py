"""The supervisor, with workers that are three lines long."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from activestructure_gym.cores import core_count
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.comparison import run_directory
from activestructure_gym.evaluation.archive.completion import JOBS, is_done
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.engines import process
from activestructure_gym.evaluation.running.engines.base import LOGS, Limits
from activestructure_gym.evaluation.running.engines.local import run_local

# Writes a finished run, after some progress and some noise.
GOOD = """
import json, pathlib, sys
policy = json.loads(sys.stdin.readline())["policy"]
directory = pathlib.Path(sys.argv[1])
print(json.dumps({"stage": "exploring", "frames": 5, "frame_budget": 10}), flush=True)
print("not json", flush=True)
if policy == "crash":
    raise RuntimeError("the third wheel came off")
if policy == "die":
    import os, signal
    os.kill(os.getpid(), signal.SIGKILL)
if policy == "forget":
    sys.exit(0)
if policy == "slow":
    import time
    (directory.parent / f".{directory.name}.part-here-{__import__('os').getpid()}").mkdir(parents=True)
    time.sleep(60)
directory.mkdir(parents=True)
(directory / ".done").write_text(directory.name.rpartition("--")[2])
"""


class Recorder:
    def __init__(self):
        self.frames, self.outcomes, self.lost = [], [], []

    def progress(self, job, progress):
        self.frames.append((job.policy, progress.frames))

    def on_retry(self, job, error):
        self.lost.append((job.policy, error))

    def ended(self, outcome):
        self.outcomes.append(outcome)


def jobs(*policies: str) -> list[Job]:
    return [Job("box", policy, seed) for seed, policy in enumerate(policies)]


def test_every_job_gets_a_process_and_tells_its_progress(tmp_path):
    listener, todo = Recorder(), jobs("a", "b", "c")
    outcomes = run_local(todo, tmp_path, listener, Limits(2), command=("-c", GOOD))
    assert all(outcome.finished for outcome in outcomes)
    assert sorted(listener.frames) == [("a", 5), ("b", 5), ("c", 5)]
    assert all(is_done(run_directory(tmp_path, job), job) for job in todo)
    assert not any((tmp_path / LOGS).iterdir())  # nothing was said on standard error


def test_a_worker_that_dies_is_reported_and_the_others_go_on(tmp_path):
    listener = Recorder()
    outcomes = run_local(
        jobs("crash", "a", "die", "forget", "b"), tmp_path, listener, Limits(2, retries=0), command=("-c", GOOD)
    )
    errors = {outcome.job.policy: outcome.error for outcome in outcomes}
    assert errors["a"] is None and errors["b"] is None
    assert errors["crash"] == "RuntimeError: the third wheel came off (exit code 1)"
    assert errors["die"] == "the worker wrote nothing (killed by signal 9, SIGKILL: perhaps because memory ran out)"
    assert errors["forget"] == "the policy ended the process (exit code 0) before the run was done"
    assert sorted(path.name for path in (tmp_path / JOBS).iterdir()) == sorted(
        run_directory(tmp_path, outcome.job).name for outcome in outcomes if outcome.finished
    )


# The first attempt at a job ends as its policy says, the second one finishes.
FRAGILE = """
import json, os, pathlib, signal, sys, time
policy = json.loads(sys.stdin.readline())["policy"]
directory = pathlib.Path(sys.argv[1])
first = directory.parent.parent / (policy + ".tried")
tried = first.exists()
first.touch()
print("attempt of", policy, file=sys.stderr, flush=True)
if policy == "late" and not tried:  # the result is whole, the process is killed before it ends
    pass
elif not tried:
    if policy == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if policy == "terminated":
        sys.exit(128 + signal.SIGTERM)
    if policy == "deaf":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if policy in ("deaf", "hanging"):
        time.sleep(60)
    sys.exit(2)
directory.mkdir(parents=True)
(directory / ".done").write_text(directory.name.rpartition("--")[2])
if policy == "late":
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_was_killed_is_tried_again_and_what_failed_by_itself_is_not(tmp_path):
    listener = Recorder()
    run_local(jobs("killed", "wrong", "terminated", "late"), tmp_path, listener, Limits(1), command=("-c", FRAGILE))
    ended = {outcome.job.policy: (outcome.finished, outcome.attempts) for outcome in listener.outcomes}
    assert ended == {"killed": (True, 2), "wrong": (False, 1), "terminated": (True, 2), "late": (True, 1)}
    # The lost ones have their second turn after all others have had their first.
    assert [outcome.job.policy for outcome in listener.outcomes] == ["wrong", "late", "killed", "terminated"]
    assert listener.lost == [
        ("killed", "attempt of killed (killed by signal 9, SIGKILL: perhaps because memory ran out)"),
        ("terminated", "attempt of terminated (exit code 143)"),
    ]
    (log,) = (tmp_path / LOGS).glob("*killed*")
    assert log.read_text() == 2 * "attempt of killed\n"


def test_without_retries_one_attempt_is_all(tmp_path):
    (outcome,) = run_local(jobs("killed"), tmp_path, Recorder(), Limits(retries=0), command=("-c", FRAGILE))
    assert not outcome.finished and "killed by signal 9" in outcome.error


def test_a_job_that_takes_too_long_is_stopped_and_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr(process, "GRACE_SECONDS", 0.3)  # for the one that does not listen
    listener, seconds = Recorder(), 2.0
    limits = Limits(workers=2, timeout_min=seconds / 60)
    outcomes = run_local(jobs("hanging", "deaf"), tmp_path, listener, limits, command=("-c", FRAGILE))
    assert [(outcome.finished, outcome.attempts) for outcome in outcomes] == [(True, 2)] * 2
    reason = f"stopped after {seconds / 60:g} min (--timeout-min)"
    assert sorted(listener.lost) == [("deaf", reason), ("hanging", reason)]


@pytest.mark.parametrize(
    "wrong",
    [{"workers": -1}, {"timeout_min": -1}, {"timeout_min": float("nan")}, {"timeout_min": 1e300}, {"retries": -1}],
)
def test_wrong_limits_are_one_sentence(wrong):
    (name,) = wrong
    with pytest.raises(InputError, match=f"^--{name.replace('_', '-')} must be a .* from 0 to "):
        Limits(**wrong)


def test_workers_get_their_share_of_the_threads_and_the_callers_modules(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path / "modules"))
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "only_here.py").write_text("")
    script = "import only_here, os, sys; sys.exit(os.environ['OMP_NUM_THREADS'] + os.environ['OMP_WAIT_POLICY'])"
    outcome = run_local(jobs("a"), tmp_path, Recorder(), Limits(1), command=("-c", script))[0]
    assert outcome.error == f"{core_count()}PASSIVE (exit code 1)"


SUPERVISOR = f"""
import signal, sys
from pathlib import Path
from activestructure_gym.evaluation.running.engines.base import Limits
from activestructure_gym.evaluation.running.engines.local import run_local
from activestructure_gym.evaluation.archive.jobs import Job
class Quiet:
    def progress(self, job, progress): print("running", flush=True)
    def ended(self, outcome): pass
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs hand down that it is ignored
jobs = [Job("box", "slow", 0), Job("box", "slow", 1)]
run_local(jobs, Path(sys.argv[1]), Quiet(), Limits(2), command=("-c", {GOOD!r}))
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks processes up in /proc")
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_its_supervisor(tmp_path, ending):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([os.getcwd(), *sys.path])}
    script = textwrap.dedent(SUPERVISOR)
    if ending is signal.SIGKILL:
        # The real worker follows its standard input; let the stand-in do the same.
        script = script.replace("time.sleep(60)", "sys.stdin.read()")
    supervisor = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    )
    for _ in range(2):
        assert supervisor.stdout.readline() == b"running\n"
    workers = _children(supervisor.pid)
    assert len(workers) == 2
    supervisor.send_signal(ending)
    supervisor.wait(20)
    deadline = time.monotonic() + 10
    while any(_runs(worker) for worker in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(_runs(worker) for worker in workers)
    if ending is signal.SIGINT:
        assert not any((tmp_path / JOBS).iterdir())  # the half-written directories are gone
    supervisor.stdout.close()
    supervisor.stderr.close()


def _children(process: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process:
            found.append(int(stat.parent.name))
    return found


def _runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
