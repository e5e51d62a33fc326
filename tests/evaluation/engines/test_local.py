"""The supervisor, with workers that are three lines long."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from activestructure_gym.evaluation.engines import run_local
from activestructure_gym.evaluation.engines.base import JOBS, LOGS, run_directory
from activestructure_gym.evaluation.jobs import Job
from activestructure_gym.evaluation.store import is_done
from activestructure_gym.evaluation.threads import core_count

# Writes a finished run, after some progress and some noise.
GOOD = """
import json, pathlib, sys
from activestructure_gym.evaluation.jobs import Job
job = Job.from_dict(json.loads(sys.stdin.readline()))
print(json.dumps({"stage": "exploring", "frames": 5, "frame_budget": 10}), flush=True)
print("not json", flush=True)
if job.policy == "crash":
    raise RuntimeError("the third wheel came off")
if job.policy == "die":
    import os, signal
    os.kill(os.getpid(), signal.SIGKILL)
if job.policy == "forget":
    sys.exit(0)
if job.policy == "slow":
    import time
    (pathlib.Path(sys.argv[1]).parent / f".{job.name}.part-{__import__('os').getpid()}").mkdir(parents=True)
    time.sleep(60)
directory = pathlib.Path(sys.argv[1])
directory.mkdir(parents=True)
(directory / ".done").write_text(job.hash)
"""


class Recorder:
    def __init__(self):
        self.frames, self.outcomes = [], []

    def progress(self, job, progress):
        self.frames.append((job.policy, progress.frames))

    def ended(self, outcome):
        self.outcomes.append(outcome)


def jobs(*policies: str) -> list[Job]:
    return [Job("box", policy, seed) for seed, policy in enumerate(policies)]


def test_every_job_gets_a_process_and_tells_its_progress(tmp_path):
    listener, todo = Recorder(), jobs("a", "b", "c")
    outcomes = run_local(todo, tmp_path, listener, 2, command=("-c", GOOD))
    assert all(outcome.finished for outcome in outcomes)
    assert sorted(listener.frames) == [("a", 5), ("b", 5), ("c", 5)]
    assert all(is_done(run_directory(tmp_path, job), job) for job in todo)
    assert not any((tmp_path / LOGS).iterdir())  # nothing was said on standard error


def test_a_worker_that_dies_is_reported_and_the_others_go_on(tmp_path):
    listener = Recorder()
    outcomes = run_local(jobs("crash", "a", "die", "forget", "b"), tmp_path, listener, 2, command=("-c", GOOD))
    errors = {outcome.job.policy: outcome.error for outcome in outcomes}
    assert errors["a"] is None and errors["b"] is None
    assert errors["crash"] == "RuntimeError: the third wheel came off (exit code 1)"
    assert errors["die"] == "the worker wrote nothing (killed by signal 9)"
    assert errors["forget"] == "the worker wrote nothing (exit code 0)"  # said it was done and was not
    assert sorted(path.name for path in (tmp_path / JOBS).iterdir()) == sorted(
        run_directory(tmp_path, outcome.job).name for outcome in outcomes if outcome.finished
    )


def test_workers_get_their_share_of_the_threads_and_the_callers_modules(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path / "modules"))
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "only_here.py").write_text("")
    script = "import only_here, os, sys; sys.exit(os.environ['OMP_NUM_THREADS'] + os.environ['OMP_WAIT_POLICY'])"
    outcome = run_local(jobs("a"), tmp_path, Recorder(), 1, command=("-c", script))[0]
    assert outcome.error == f"{core_count()}PASSIVE (exit code 1)"


SUPERVISOR = f"""
import sys
from pathlib import Path
from activestructure_gym.evaluation.engines import run_local
from activestructure_gym.evaluation.jobs import Job
class Quiet:
    def progress(self, job, progress): print("running", flush=True)
    def ended(self, outcome): pass
run_local([Job("box", "slow", 0), Job("box", "slow", 1)], Path(sys.argv[1]), Quiet(), 2, command=("-c", {GOOD!r}))
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
