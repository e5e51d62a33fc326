"""The calls of a first use need the right kernels, and compile each of them once and quietly."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof

from activestructure_gym import first_use
from activestructure_gym.compiling import progress
from activestructure_gym.compiling.thread_team import TEAM
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.splatting import render
from activestructure_gym.volume import VolumeConfig, VoxelVolume

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def test_the_calls_are_those_of_a_first_keyframe_and_a_first_decision() -> None:
    of_keyframe, of_decision = (
        {kernel.py_func.__name__: tuple(map(typeof, arguments)) for kernel, arguments in calls}
        for calls in first_use.calls_of_the_rasteriser()
    )
    called = {}
    run = TEAM.run

    def listen(kernel, arguments, threads):
        called.setdefault(kernel.py_func.__name__, tuple(typeof(argument) for argument in arguments))
        run(kernel, arguments, threads)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TEAM, "run", listen)
        mapper = first_use.map_a_wall()
        assert called == of_keyframe and list(called) == list(of_keyframe)
        called.clear()
        first_use.score_the_wall(mapper)
    assert called == of_decision


def test_noting_calls_leaves_the_rasteriser_as_it_was() -> None:
    first_use.calls_of_the_rasteriser.cache_clear()
    parameters = np.zeros((14, 16), np.float32)
    parameters[2], parameters[3], parameters[7:10], parameters[10], parameters[11] = 1.0, 1.0, -1.0, 5.0, 1.0
    arguments = parameters, 16, PinholeCamera.from_size(32, 32), np.eye(4)
    before = render(*arguments)
    first_use.calls_of_the_rasteriser()
    after = render(*arguments)
    assert before.alpha.max() > 0.9
    assert np.array_equal(before.color, after.color) and np.array_equal(before.alpha, after.alpha)


def test_what_another_process_is_at_is_left_to_it(monkeypatch) -> None:
    asked = []

    class Kernel:
        def __init__(self, name: str) -> None:
            self.py_func = SimpleNamespace(__module__="room", __qualname__=name)

        def compile(self, signature) -> None:
            asked.append(self.py_func.__qualname__)

    calls = tuple([(Kernel(name), (1,)) for name in names] for names in (("first", "second", "third"), ("fourth",)))
    monkeypatch.setattr(first_use, "calls_of_the_rasteriser", lambda: calls)
    monkeypatch.setattr(first_use.LOCKS, "is_held", lambda name: name == "room.second")
    first_use.rasteriser()
    assert asked == ["third", "first"]  # its parent begins with the first
    first_use.score()
    assert asked[2:] == ["fourth"]


def test_the_path_around_a_corner_needs_the_tree_of_the_planner() -> None:
    volume = VoxelVolume(np.array([[0.0, 0.0, 0.0], [3.0, 3.0, 2.0]]), VolumeConfig())
    assert len(first_use.plan_around_a_corner(volume)) > 2  # no straight line


@pytest.mark.parametrize("part", ["motion", "views", "sensing"])
def test_the_parts_run(part) -> None:
    getattr(first_use, part)()


FIRST_USE = """
from activestructure_gym import first_use
first_use.map_making()
"""

SECOND_USE = """
from activestructure_gym import first_use
from activestructure_gym.compiling import told_to
compiled = []
with told_to(compiled.append):
    first_use.map_making()
print(*compiled)
"""


@pytest.mark.slow
def test_a_first_use_is_whole_and_quiet(tmp_path) -> None:
    environment = {**ENVIRONMENT, "NUMBA_CACHE_DIR": str(tmp_path)}
    options = {"env": environment, "capture_output": True, "text": True, "check": True, "timeout": 300}
    first = subprocess.run([sys.executable, "-c", FIRST_USE], **options)
    said = first.stderr.splitlines()
    assert first.stdout == "" and len(said) <= 4
    assert said[0] == progress.begin() and said[-1].startswith("compiled ")
    assert subprocess.run([sys.executable, "-c", SECOND_USE], **options).stdout == "\n"
