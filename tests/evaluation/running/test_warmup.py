"""What the warm-up says about its compiling."""

import io
import json
import os
import subprocess
import sys

import pytest

from activestructure_gym import compiling
from activestructure_gym.compiling import files, progress
from activestructure_gym.evaluation.running import warmup
from activestructure_gym.evaluation.running.warmup import (
    WarmMark,
    _listen,
    _Tally,
    all_gains,
    main,
    smallest_job,
    warming_up,
)
from activestructure_gym.policies import POLICIES, Policy


@pytest.fixture
def room(tmp_path, monkeypatch):
    """A room of one module with one compiled kernel, in place of the package."""
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    (tmp_path / "module.py").write_text("x = 1")
    files.write(cache / "module.kernel-1.kernel", bytes(32), b"machine code")
    monkeypatch.setattr(warmup, "_rooms", lambda: [tmp_path])
    monkeypatch.setattr(compiling, "cache_place", lambda: cache)
    return tmp_path


def holds(policies=("random", "pixel_only"), overrides=()):
    return WarmMark.of(smallest_job(policies, dict(overrides))).holds()


def test_nothing_is_started_where_the_same_warm_up_came_to_its_end(room, monkeypatch):
    started = []

    class Ended:
        pid = -1

        def __init__(self, part, *_):
            started.append(part)

        def wait(self, timeout):
            return 0

        def terminate(self):
            pass

    monkeypatch.setattr(warmup, "_start", Ended)
    for _ in range(2):
        with warming_up(["random"], {}):
            pass
    assert started == ["map", "world"]
    with warming_up(["pixel_only"], {}):  # asks for more gains
        pass
    with warming_up(["random"], {"sensor.depth_noise": "kinect"}):
        pass
    assert len(started) == 6
    monkeypatch.setattr(Ended, "wait", lambda self, timeout: 1)  # fails
    for _ in range(2):
        with warming_up(["random"], {"sensor.depth_noise": "none"}):
            pass
    assert len(started) == 10


def test_the_mark_holds_for_the_same_sources_settings_and_kernels_only(room, monkeypatch):
    assert not holds()
    WarmMark.of(smallest_job(["pixel_only"], {})).leave()
    assert holds() and not holds(["random"])
    (room / "__pycache__" / "module.other-2.kernel").touch()  # what is compiled later does no harm
    assert holds()
    with monkeypatch.context() as patch:
        patch.setenv("NUMBA_CPU_NAME", "generic")
        assert not holds()
    (room / "__pycache__" / "module.kernel-1.kernel").rename(room / "elsewhere")
    assert not holds()
    (room / "elsewhere").rename(room / "__pycache__" / "module.kernel-1.kernel")
    assert holds()
    (room / "__pycache__" / "module.kernel-1.kernel").write_bytes(b"")  # damaged
    assert not holds()
    files.write(room / "__pycache__" / "module.kernel-1.kernel", bytes(32), b"compiled again")
    assert holds()
    os.utime(room / "module.py", (1, 1))
    assert not holds()


def test_no_mark_for_what_lies_outside_or_cannot_be_kept(room, monkeypatch):
    mine = type("Mine", (Policy,), {"__module__": "my_package", "act": lambda *_: 0})
    monkeypatch.setitem(POLICIES._entries, "mine", mine)
    assert WarmMark.of(smallest_job(["mine"], {})) is None
    assert WarmMark.of(smallest_job(["random"], {"gains": "my_package:gain"})) is None
    assert WarmMark.of(smallest_job(["random"], {})) is not None
    monkeypatch.setattr(compiling, "cache_place", lambda: None)
    assert WarmMark.of(smallest_job(["random"], {})) is None


def test_the_rooms_are_those_with_kernels():
    names = {file.name for room in warmup._rooms() for file in room.rglob("*.py")}
    assert {"kernels.py", "windows.py", "reconstruction_env.py", "greedy.py"} <= names


def test_a_kernel_counts_once_whoever_compiles_it():
    said = []
    tally = _Tally(said.append)
    for name in ("room.one", "room.two", "room.one"):
        tally(name)
    tally.conclude()
    assert said[0] == progress.begin() and said[-1].startswith("compiled 2 kernels in ")
    counts = [line.rpartition(",")[0] for line in said[1:-1]]
    assert counts == [f"compiling kernels, once per installation: {number} so far" for number in (1, 2, 2)]
    said.clear()
    tally = _Tally(said.append, {"room.one", "room.two", "room.three"})
    for name in ("room.one", "mine.one"):  # a kernel of the user's own is one more
        tally(name)
    counts = [line.rpartition(": ")[2].rpartition(",")[0] for line in said[1:]]
    assert counts == ["1 of 3", "2 of 4"]
    said.clear()
    _Tally(said.append).conclude()  # nothing had to be compiled
    assert said == []


def test_only_marked_lines_of_a_process_are_kernels():
    code = "print('compiling room.one'); print('policy speaks'); print(); print('compiling room.two')"
    heard = []
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        _listen(process, heard.append)
    assert heard == ["room.one", "room.two"]


def test_every_gain_of_every_policy_is_asked_for():
    found = all_gains(["random", "pixel_only", "activestructure", "pixel_only"])
    assert found == ["deficiency", "pixel", "unknown_volume_way"]


@pytest.mark.parametrize("part", ["map", "world"])
def test_both_halves_do_their_part_of_the_work(part, monkeypatch):
    from activestructure_gym import compile_ahead
    from activestructure_gym.evaluation.running import episode

    done = []
    for name in ("compile_map", "compile_sensing", "compile_motion", "compile_views"):
        monkeypatch.setattr(compile_ahead, name, lambda name=name: done.append(name))
    monkeypatch.setattr(episode, "run_job", lambda job, place: done.append(job.policy))
    monkeypatch.setattr(warmup, "_evaluate", lambda gains, job: done.append(tuple(gains)))
    monkeypatch.setattr(warmup.signal, "signal", lambda *_: None)
    work = {"job": smallest_job(["random", "pixel_only"], {}).as_dict(), "gains": ["hole_area", "pixel"]}
    monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps(work) + "\n"))
    main(part)
    of_the_world = ["compile_sensing", "compile_motion", "compile_views", "pixel_only", ("hole_area", "pixel")]
    assert done == (["compile_map"] if part == "map" else of_the_world)


DEAF = "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(1, flush=True); time.sleep(60)"


def test_a_policy_of_others_that_never_ends_does_not_hold_the_comparison(room, monkeypatch):
    processes = []

    def start(part, *_):
        processes.append(subprocess.Popen([sys.executable, "-c", DEAF], stdout=subprocess.PIPE, start_new_session=True))
        assert processes[-1].stdout.readline() == b"1\n"
        return processes[-1]

    monkeypatch.setattr(warmup, "_start", start)
    monkeypatch.setattr(warmup, "_PATIENCE_S", 0.2)
    monkeypatch.setattr(warmup, "_GRACE_S", 0.2)
    with warming_up(["random"], {}):
        pass
    assert [process.returncode for process in processes] == [-9, -9] and not holds(["random"])
