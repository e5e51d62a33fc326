"""Other processes compile ahead: one helper, and only where it helps; those of a comparison, until they end or hang."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from activestructure_gym import first_use
from activestructure_gym.compiling import ahead, files, locks, progress, told_to
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

    monkeypatch.setattr(ahead, "LOCKS", Locks())
    monkeypatch.setattr(ahead, "_started", [])
    monkeypatch.setattr(ahead, "atexit", SimpleNamespace(register=lambda *_, **__: None))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(ahead, "subprocess", SimpleNamespace(Popen=Process, DEVNULL=subprocess.DEVNULL))
    return commands


pytestmark = pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")


def test_a_process_starts_one_helper(started) -> None:
    importlib.import_module("activestructure_gym.volume")  # what an episode imports
    ahead.start_helper()
    ahead.start_helper()
    assert len(started) == 1
    (command, environment) = started[0]
    # As in docs/notebook/performance.md: this is what a list of processes shows.
    assert command[:4] == [sys.executable, "-P", "-m", "activestructure_gym.compiling"]
    parts = ["rasteriser", "motion", "views", "score", "sensing"]
    assert command[4:6] == [str(os.getpid()), "activestructure_gym.compiling.ahead:be_the_helper"]
    assert command[6:] == [f"activestructure_gym.first_use:{part}" for part in parts]
    assert all(callable(getattr(first_use, part)) for part in parts)
    assert environment["PYTHONPATH"].split(os.pathsep) == [os.path.abspath(entry) for entry in sys.path]


def test_who_has_no_volume_gets_the_rasteriser_alone(started, monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "activestructure_gym.volume", raising=False)
    ahead.start_helper()
    assert started[0][0][6:] == ["activestructure_gym.first_use:rasteriser"]


@pytest.mark.parametrize(
    "why", ["switched off", "one core", "nothing is kept", "a worker", "no interpreter", "no locks"]
)
def test_no_helper_where_it_is_of_no_use(started, monkeypatch, why) -> None:
    if why == "switched off":
        monkeypatch.setenv(ahead.SWITCH, "0")
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
        ahead.LOCKS.usable = False
    ahead.start_helper()
    assert started == []


def test_only_our_own_kernels_call_for_help(started, monkeypatch) -> None:
    for module, helpers in (("users.own", 0), ("activestructure_gym.splatting", 1)):
        voice = progress.Progress()
        voice.call_for_help = ahead.start_helper
        monkeypatch.setattr(voice, "_silent", True)
        with voice.around(f"{module}.function"):
            voice.on_start(None)
        assert len(started) == helpers
    monkeypatch.setattr(ahead, "_started", [])
    with told_to(lambda name: None), progress.PROGRESS.around("activestructure_gym.splatting.other"):
        progress.PROGRESS.on_start(None)
    assert len(started) == 1  # whoever listens shares the work otherwise


HOLD = """
import sys
from activestructure_gym.compiling.ahead import be_the_helper
be_the_helper()
print("alone", flush=True)
sys.stdin.readline()
"""


def test_one_helper_per_installation(started, start, kept) -> None:
    with start(kept, HOLD, cache=kept) as first:
        assert first.stdout.readline() == "alone\n"
        with start(kept, HOLD, cache=kept) as second:
            assert second.communicate("\n")[0] == ""
        ahead.start_helper()
        assert started == []
        first.communicate("\n")
    with start(kept, HOLD, cache=kept) as third:
        assert third.communicate("\n")[0] == "alone\n"


CALLS = """
import sys, time
from numpy import arange
from tiny import doubled, total


def compile_one(what):
    print("a policy speaks")
    doubled(2) if what == "doubled" else total(arange(3.0))


def fail():
    raise RuntimeError


def hang():
    import signal
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(60)
"""


@pytest.fixture
def beside(package, monkeypatch, tmp_path):
    """Make processes compile beside a short block; return the kernels heard of, and which processes succeeded."""
    (package / "calls.py").write_text(CALLS)
    monkeypatch.syspath_prepend(str(package))

    def call(*calls: list[str]) -> tuple[list[str], list[bool]]:
        heard: list[str] = []
        more = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        with ahead.compiling_beside(calls, heard.append, more) as succeeded:
            pass
        return sorted(set(heard)), succeeded

    return call


def test_processes_compile_and_are_heard_of_and_waited_for(beside) -> None:
    calls = ['calls:compile_one "doubled"'], ['calls:compile_one "total"']
    assert beside(*calls, ["calls:fail"]) == (["tiny.doubled", "tiny.total"], [True, True, False])
    assert beside(*calls) == ([], [True, True])


def test_a_call_that_never_ends_is_not_waited_for(beside, monkeypatch) -> None:
    monkeypatch.setattr(ahead, "_PATIENCE_S", 4.0)
    monkeypatch.setattr(ahead, "_GRACE_S", 0.2)
    assert beside(["calls:hang"])[1] == [False]


def test_they_end_with_a_block_that_fails(monkeypatch) -> None:
    ended = []
    monkeypatch.setattr(ahead, "_dismiss", lambda process, *_: ended.append((process.kill(), process.wait())))
    with pytest.raises(KeyError), ahead.compiling_beside([["time:sleep 60"]] * 2, print):
        raise KeyError
    assert len(ended) == 2


PARENT = """
import subprocess, sys
subprocess.Popen([sys.executable, "-P", "-m", "activestructure_gym.compiling", str(__import__("os").getpid()),
                  "calls:say", "time:sleep 60"])
sys.stdin.readline()
"""


def test_a_process_ends_with_its_parent(start, package, tmp_path) -> None:
    (package / "calls.py").write_text("def say():\n    print('up', flush=True)\n")
    parent = start(package, PARENT, cache=tmp_path / "cache")
    assert parent.stdout.readline() == "up\n"
    parent.kill()
    assert parent.communicate(timeout=30) == ("", "")  # the pipes are closed: no process holds their other ends
