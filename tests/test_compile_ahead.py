"""A second process compiles what a first use comes to late: the right kernels, once, quietly, and not for ever."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof

from activestructure_gym import compile_ahead, compiling
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import render
from activestructure_gym.splatting.crew import CREW
from activestructure_gym.volume import VolumeConfig, VoxelVolume

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def test_the_signatures_are_those_of_real_calls() -> None:
    noted = compile_ahead.calls_of_the_map()
    assert set(noted) == set(compile_ahead._ORDER)
    called = {}
    run = CREW.run

    def listen(kernel, arguments, threads):
        called.setdefault(kernel.py_func.__name__, tuple(typeof(argument) for argument in arguments))
        run(kernel, arguments, threads)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CREW, "run", listen)
        compile_ahead.compile_map()
    assert {name: tuple(map(typeof, arguments)) for name, (_, arguments) in noted.items()} == called


def test_noting_calls_leaves_the_rasteriser_as_it_was() -> None:
    compile_ahead.calls_of_the_map.cache_clear()
    parameters = np.zeros((14, 16), np.float32)
    parameters[2], parameters[3], parameters[7:10], parameters[10], parameters[11] = 1.0, 1.0, -1.0, 5.0, 1.0
    arguments = parameters, 16, PinholeCamera.from_size(32, 32), np.eye(4)
    before = render(*arguments)
    compile_ahead.calls_of_the_map()
    after = render(*arguments)
    assert before.alpha.max() > 0.9
    assert np.array_equal(before.color, after.color) and np.array_equal(before.alpha, after.alpha)


def test_what_another_process_is_at_or_has_done_is_left_to_it(monkeypatch) -> None:
    asked = []

    class Kernel:
        def __init__(self, name: str) -> None:
            self.name, self.stats = name, self
            self.cache_hits = {"signature": 1} if name == "prepare" else {}

        def compile(self, signature) -> None:
            asked.append(self.name)

    calls = {name: (Kernel(name), (1,)) for name in compile_ahead._ORDER}
    monkeypatch.setattr(compile_ahead, "calls_of_the_map", lambda: calls)
    monkeypatch.setattr(compile_ahead, "held_elsewhere", lambda kernel: kernel.name == "blend")
    compile_ahead.compile_rasteriser()
    assert asked == ["compare", "unblend", "prepare"]  # prepare came from the cache: score is no good bargain
    compile_ahead.compile_score()
    assert asked[3:] == ["score"]
    calls["prepare"][0].cache_hits = {}
    compile_ahead.compile_rasteriser()
    assert asked[4:] == ["compare", "unblend", "prepare", "score"]


def test_the_path_around_a_corner_needs_the_tree_of_the_planner() -> None:
    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 2.0]]), VolumeConfig())
    assert len(compile_ahead.plan_around_a_corner(volume)) > 2  # no straight line


@pytest.mark.parametrize("part", ["motion", "views", "sensing"])
def test_the_parts_run(part) -> None:
    compile_ahead.PARTS[part]()


@pytest.fixture
def started(monkeypatch, tmp_path) -> list[list[str]]:
    """Commands of the helpers that would have been started; a machine on which one would be."""
    from numba import config

    commands = []

    class Process:
        def __init__(self, command, **options) -> None:
            commands.append(command)

        def kill(self) -> None: ...

        wait = kill

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "_LOCKS", compiling._Locks())
    monkeypatch.setattr(compiling, "_HELPED", [])
    monkeypatch.setattr(compiling, "_WARNED", [])
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(compiling, "subprocess", SimpleNamespace(Popen=Process, DEVNULL=subprocess.DEVNULL))
    return commands


pytestmark = pytest.mark.skipif(compiling.fcntl is None, reason="no locks between processes here")


def test_a_process_starts_one_helper(started) -> None:
    compiling._get_help()
    compiling._get_help()
    assert len(started) == 1
    path, parent, *parts = started[0][3:]
    assert (path.split(os.pathsep), parent) == (sys.path, str(os.getpid()))
    assert parts == list(compile_ahead.PARTS)  # the volume is imported here: an episode


def test_who_has_no_volume_gets_the_rasteriser_alone(started, monkeypatch) -> None:
    monkeypatch.delitem(sys.modules, "activestructure_gym.volume")
    compiling._get_help()
    assert started[0][5:] == ["rasteriser"]


@pytest.mark.parametrize("why", ["one core", "nothing is kept", "a worker", "no interpreter", "no locks"])
def test_no_helper_where_it_is_of_no_use(started, monkeypatch, why) -> None:
    if why == "one core":
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
        monkeypatch.setattr(os, "cpu_count", lambda: 1)
    elif why == "nothing is kept":
        monkeypatch.setattr(compiling, "_WARNED", ["disk full"])
    elif why == "a worker":
        monkeypatch.setattr(multiprocessing, "parent_process", lambda: object())
    elif why == "no interpreter":
        monkeypatch.setattr(sys, "executable", "/opt/program/program")
    else:
        compiling._LOCKS.usable = False
    compiling._get_help()
    assert started == []


def test_only_our_own_kernels_call_for_help(started, monkeypatch) -> None:
    for module, helpers in (("users.own", 0), ("activestructure_gym.splatting", 1)):
        monkeypatch.setattr(compiling, "_VOICE", voice := compiling._Voice())
        monkeypatch.setattr(voice, "_write", lambda line: None)
        with voice.around(f"{module}.function"):
            voice.on_start(None)
        assert len(started) == helpers
    monkeypatch.setattr(compiling, "_HELPED", [])
    with compiling.told_to(lambda name: None), compiling._VOICE.around("activestructure_gym.splatting.other"):
        compiling._VOICE.on_start(None)
    assert len(started) == 1  # whoever listens shares the work otherwise


HOLD = """
import sys
from activestructure_gym.compiling import only_helper
with only_helper() as alone:
    print(alone, flush=True)
    sys.stdin.readline()
"""


def hold(cache: Path) -> subprocess.Popen[str]:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {**ENVIRONMENT, "NUMBA_CACHE_DIR": str(cache)}
    return subprocess.Popen([sys.executable, "-c", HOLD], env=environment, text=True, **pipes)


def test_one_helper_per_installation(started, tmp_path) -> None:
    with hold(tmp_path) as first:
        assert first.stdout.readline() == "True\n"
        with hold(tmp_path) as second:
            assert second.communicate("\n")[0] == "False\n"
        compiling._get_help()
        assert started == []
        first.communicate("\n")
    with hold(tmp_path) as third:
        assert third.communicate("\n")[0] == "True\n"


WAITING = """
import os
from activestructure_gym import compile_ahead
parent = os.getppid()  # before anybody can end
print("up", flush=True)
compile_ahead._end_with(parent)
"""

PARENT = f"""
import subprocess, sys
subprocess.Popen([sys.executable, "-c", '''{WAITING}'''])
sys.stdin.readline()
"""


def test_a_helper_ends_with_its_parent() -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    parent = subprocess.Popen([sys.executable, "-c", PARENT], env=ENVIRONMENT, text=True, **pipes)
    assert parent.stdout.readline() == "up\n"
    parent.kill()
    assert parent.communicate(timeout=30)[0] == ""  # the pipe is closed: nobody holds its other end any longer


FIRST_USE = """
from activestructure_gym import compile_ahead
compile_ahead.compile_map()
"""

SECOND_USE = """
from activestructure_gym import compile_ahead
from activestructure_gym.compiling import told_to
compiled = []
with told_to(compiled.append):
    compile_ahead.compile_map()
print(*compiled)
"""


@pytest.mark.slow
def test_a_first_use_is_whole_and_quiet(tmp_path) -> None:
    environment = {**ENVIRONMENT, "NUMBA_CACHE_DIR": str(tmp_path)}
    options = {"env": environment, "capture_output": True, "text": True, "check": True, "timeout": 300}
    first = subprocess.run([sys.executable, "-c", FIRST_USE], **options)
    assert (first.stdout, first.stderr) == ("", "compiling kernels, once per installation (half a minute)\n")
    assert subprocess.run([sys.executable, "-c", SECOND_USE], **options).stdout == "\n"
