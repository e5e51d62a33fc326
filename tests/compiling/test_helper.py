"""A second process compiles what a first use comes to late: one of them, and only where it helps."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from activestructure_gym import compile_ahead
from activestructure_gym.compiling import files, helper, locks, progress, told_to
from activestructure_gym.compiling.locks import Locks


@pytest.fixture
def started(monkeypatch, kept) -> list[tuple[list[str], dict[str, str]]]:
    """Commands and environments of the helpers that would have been started; a machine on which one would be."""
    commands = []

    class Process:
        def __init__(self, command, **options) -> None:
            commands.append((command, options["env"]))

        def kill(self) -> None: ...

        wait = kill

    monkeypatch.setattr(helper, "LOCKS", Locks())
    monkeypatch.setattr(helper, "_started", [])
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(helper, "subprocess", SimpleNamespace(Popen=Process, DEVNULL=subprocess.DEVNULL))
    return commands


pytestmark = pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")


def test_a_process_starts_one_helper(started) -> None:
    importlib.import_module("activestructure_gym.volume")  # what an episode imports
    helper.start_helper()
    helper.start_helper()
    assert len(started) == 1
    (command, environment) = started[0]
    assert command[:4] == [
        sys.executable,
        "-P",
        "-m",
        "activestructure_gym.compile_ahead",
    ]  # what a list of processes says
    assert command[4:] == [str(os.getpid()), *compile_ahead.PARTS]
    assert environment["PYTHONPATH"].split(os.pathsep) == [os.path.abspath(entry) for entry in sys.path]


def test_who_has_no_volume_gets_the_rasteriser_alone(started, monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "activestructure_gym.volume", raising=False)
    helper.start_helper()
    assert started[0][0][5:] == ["rasteriser"]


@pytest.mark.parametrize(
    "why", ["switched off", "one core", "nothing is kept", "a worker", "no interpreter", "no locks"]
)
def test_no_helper_where_it_is_of_no_use(started, monkeypatch, why) -> None:
    if why == "switched off":
        monkeypatch.setenv(helper.SWITCH, "0")
    elif why == "one core":
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
        monkeypatch.setattr(os, "cpu_count", lambda: 1)
    elif why == "nothing is kept":
        monkeypatch.setattr(files, "not_kept", ["disk full"])
    elif why == "a worker":
        monkeypatch.setattr(multiprocessing, "parent_process", lambda: object())
    elif why == "no interpreter":
        monkeypatch.setattr(sys, "executable", "/opt/program/program")
    else:
        helper.LOCKS.usable = False
    helper.start_helper()
    assert started == []


def test_only_our_own_kernels_call_for_help(started, monkeypatch) -> None:
    for module, helpers in (("users.own", 0), ("activestructure_gym.splatting", 1)):
        voice = progress.Progress()
        monkeypatch.setattr(voice, "_silent", True)
        with voice.around(f"{module}.function"):
            voice.on_start(None)
        assert len(started) == helpers
    monkeypatch.setattr(helper, "_started", [])
    with told_to(lambda name: None), progress.PROGRESS.around("activestructure_gym.splatting.other"):
        progress.PROGRESS.on_start(None)
    assert len(started) == 1  # whoever listens shares the work otherwise


HOLD = """
import sys
from activestructure_gym.compiling.helper import only_helper
with only_helper() as alone:
    print(alone, flush=True)
    sys.stdin.readline()
"""


def test_one_helper_per_installation(started, start, kept) -> None:
    with start(kept, HOLD, cache=kept) as first:
        assert first.stdout.readline() == "True\n"
        with start(kept, HOLD, cache=kept) as second:
            assert second.communicate("\n")[0] == "False\n"
        helper.start_helper()
        assert started == []
        first.communicate("\n")
    with start(kept, HOLD, cache=kept) as third:
        assert third.communicate("\n")[0] == "True\n"
