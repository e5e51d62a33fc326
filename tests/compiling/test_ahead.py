"""Helpers compile the listed kernels, only where that helps, and end with their parent."""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof, types

from activestructure_gym.compiling import ahead, files, locks, progress, stamps, told_to
from activestructure_gym.compiling.ahead import ListedKernel, listed_kernels, signature_of
from activestructure_gym.compiling.locks import Locks
from activestructure_gym.geometry.camera import Lens

needs_locks = pytest.mark.skipif(locks.fcntl is None, reason="no locks between processes here")


class AnyModule(set[str]):
    """Contain every name, so that the kernels of all features are listed."""

    def __contains__(self, name: object) -> bool:
        return True


def text_of(kind: types.Type) -> str:
    """Write a type of numba as the list has it."""
    if isinstance(kind, types.BaseTuple):
        named = getattr(kind, "instance_class", None)
        start = f"{named.__module__.removeprefix('activestructure_gym.')}:{named.__qualname__}(" if named else "("
        return start + ", ".join(map(text_of, kind)) + (")" if named else ",)")
    if isinstance(kind, types.Array):
        axes = [":"] * kind.ndim
        if kind.layout in "CF":
            axes[-1 if kind.layout == "C" else 0] = "::1"
        return f"{kind.dtype}[{', '.join(axes)}]"
    return str(kind)


def test_every_line_of_the_list_names_a_kernel_and_types_of_arguments() -> None:
    features = {f"activestructure_gym.{kind}" for kind in ("features.unknown_volume", "policies.gavis.features")}
    assert len(listed_kernels(features)) - len(listed_kernels()) == 2
    for each in listed_kernels(AnyModule()):
        kernel = getattr(importlib.import_module(each.module), each.function)
        signature = signature_of(each.arguments)
        assert ", ".join(map(text_of, signature)) == each.arguments
        assert len(signature) == kernel.py_func.__code__.co_argcount, each


def test_a_line_gives_the_types_of_a_call() -> None:
    arguments = np.zeros((2, 2), np.float32), Lens(1.0, 2.0, 3.0, 4.0), (1, 2.0), np.zeros(4)[::2], True
    line = (
        "float32[:, ::1], geometry.camera:Lens(float64, float64, float64, float64), (int64, float64,), float64[:], bool"
    )
    assert signature_of(line) == tuple(map(typeof, arguments))


def test_a_kernel_is_kept_after_it_was_compiled(package, kept, monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(package))
    monkeypatch.delitem(sys.modules, "tiny", raising=False)
    monkeypatch.setattr(stamps, "_BEGAN", float("inf"))  # the module is newer than this process
    listed = ListedKernel("tiny", "doubled", "int64")
    assert not listed.is_kept()
    with told_to(lambda name: None):
        listed.compile()
    assert listed.is_kept()
    (file,) = kept.rglob("tiny.doubled-*.kernel")
    file.write_bytes(file.read_bytes()[:-1])
    assert not listed.is_kept()


@pytest.fixture
def started(monkeypatch, kept) -> list[tuple[list[str], list[list[str]]]]:
    """Commands of the helpers that would have been started, and their kernels; a machine with three cores."""
    commands = []

    class Process:
        def __init__(self, command, **options) -> None:
            commands.append((command[:-1], json.loads(command[-1])))

    monkeypatch.setattr(ahead, "LOCKS", Locks())
    monkeypatch.setattr(ahead, "_helpers", [])
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    monkeypatch.setattr(ahead, "subprocess", SimpleNamespace(Popen=Process, PIPE=-1, DEVNULL=-3))
    return commands


@needs_locks
def test_a_process_starts_helpers_once_for_the_modules_that_it_has_loaded(started, monkeypatch) -> None:
    importlib.import_module("activestructure_gym.volume.integration")
    monkeypatch.delitem(sys.modules, "activestructure_gym.splatting.kernels", raising=False)
    ahead.start_helpers()
    ahead.start_helpers()
    assert len(started) == 2
    command, kernels = started[1]
    assert command == [sys.executable, "-P", "-c", "from activestructure_gym.compiling.ahead import main; main(1)"]
    modules = {module for module, *_ in kernels}
    assert "activestructure_gym.volume.integration" in modules
    assert "activestructure_gym.splatting.kernels" not in modules and not any("features" in each for each in modules)


@needs_locks
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
    ahead.start_helpers()
    assert started == []


@needs_locks
def test_only_kernels_of_the_package_call_for_help(started, monkeypatch) -> None:
    for module, helpers in (("users.own", 0), ("activestructure_gym.splatting", 2)):
        mine = progress.Progress()
        mine.call_for_help = ahead.start_helpers
        monkeypatch.setattr(mine, "_silent", True)
        with mine.around(f"{module}.function"):
            mine.on_start(None)
        assert len(started) == helpers
    monkeypatch.setattr(ahead, "_helpers", [])
    with told_to(lambda name: None), progress.PROGRESS.around("activestructure_gym.splatting.other"):
        progress.PROGRESS.on_start(None)
    assert len(started) == 2


# A helper for two kernels, whose standard input stays open until the test closes it.
HELPER = """
import json, sys, time
from activestructure_gym.compiling import ahead
ahead.main(0)
print("at the end", flush=True)
time.sleep(60)
"""


@needs_locks
def test_one_helper_per_installation_compiles_and_ends_with_its_parent(started, start, package, tmp_path, kept) -> None:
    work = json.dumps(
        [ListedKernel("tiny", name, text) for name, text in (("doubled", "int64"), ("total", "float64[::1]"))]
    )
    helper = start(package, HELPER, work, cache=kept)
    assert helper.stdout.readline() == "at the end\n"
    assert len(list(kept.rglob("tiny.total-*.kernel"))) == 1 and len(list(kept.rglob("tiny.doubled-*.kernel"))) == 2
    ahead.start_helpers()  # the other holds the lock
    assert started == []
    helper.stdin.close()
    assert helper.wait(30) != 0 and helper.stdout.read() == ""
    helper.stdout.close(), helper.stderr.close()
    ahead._helpers.clear()
    ahead.start_helpers()
    assert len(started) == 2


# Prints the kernels that a run loads.
RUN = """
import sys
from pathlib import Path
from activestructure_gym.compiling import files
from tests.compiling.test_ahead import text_of

called = dict()
load = files.KernelCache.load_overload

def noted(self, signature, context):
    function = self._py_func
    module = function.__module__.removeprefix("activestructure_gym.")
    called[f"{module}:{function.__qualname__}({', '.join(map(text_of, signature))})"] = None
    return load(self, signature, context)

files.KernelCache.load_overload = noted
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.evaluation.running.episode import run_job

protocol = StandardProtocol(views=1, view_width=96, view_height=54, surface_samples=2000)
conditions = Conditions(preset="fast", frame_budget=30, protocol=protocol)
Comparison(["box"], ["activestructure"], conditions=conditions).prepare()
called.clear()
run_job(Job("box", "activestructure", 0, conditions=conditions), Path(sys.argv[1]))
print("\\n".join(called))
"""


@pytest.mark.slow
def test_an_episode_needs_no_other_kernels_than_those_of_the_list(start, tmp_path) -> None:
    """The lines that this test prints belong into the list."""
    process = start(tmp_path, RUN, str(tmp_path / "run"))
    out, err = process.communicate(timeout=900)
    assert process.returncode == 0, err
    listed = listed_kernels(["activestructure_gym.features.unknown_volume"])
    known = {f"{module}:{function}({arguments})" for module, function, arguments in listed}
    missing = [line for line in out.splitlines() if f"activestructure_gym.{line}" not in known]
    assert not missing, "\n".join(missing)
