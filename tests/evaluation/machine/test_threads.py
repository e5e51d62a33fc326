import os
import subprocess
import sys

import pytest

from activestructure_gym.evaluation.machine import threads


def test_the_cores_are_shared_out(monkeypatch):
    monkeypatch.setattr(threads, "core_count", lambda: 8)
    for slots, expected in ((1, "8"), (3, "2"), (8, "1"), (50, "1")):
        environment = threads.worker_environment(slots)
        assert environment["OMP_NUM_THREADS"] == environment["NUMBA_NUM_THREADS"] == expected
        assert environment["OMP_WAIT_POLICY"] == "PASSIVE"


def test_the_cap_is_the_variable_or_the_cores(monkeypatch):
    monkeypatch.setattr(threads, "core_count", lambda: 5)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert threads.thread_cap() == 3
    for text in ("", "0", "many"):
        monkeypatch.setenv("OMP_NUM_THREADS", text)
        assert threads.thread_cap() == 5


def test_a_wish_of_the_user_is_respected(monkeypatch):
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    threads.set_passive_waiting()
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"


@pytest.mark.parametrize("command", [("-c", "import json"), ("-m", "json.tool", "--help")])
def test_started_processes_run_nothing_that_lies_in_the_working_directory(command, tmp_path):
    (tmp_path / "json.py").write_text("raise SystemExit('ran the file of the working directory')")
    environment = threads.worker_environment(1)
    environment["PYTHONPATH"] = os.pathsep.join([*(path for path in sys.path if path), str(tmp_path)])
    done = subprocess.run([sys.executable, *command], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
