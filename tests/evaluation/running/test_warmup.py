"""Before a comparison all its kernels are compiled, with a count; nothing is started where that was done before."""

import os
from contextlib import contextmanager

import pytest

from activestructure_gym.compiling import ahead, files, progress
from activestructure_gym.evaluation.running import warmup
from activestructure_gym.evaluation.running.warmup import (
    Tally,
    all_features,
    compile_map,
    completion_marker,
    is_current,
    play,
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
    monkeypatch.setattr(files, "package_folders", lambda: [tmp_path])
    monkeypatch.setattr(files, "cache_place", lambda: cache)
    return tmp_path


@pytest.fixture
def started(monkeypatch) -> list[str]:
    """The calls that warm-ups make in other processes, of which the last may be told to fail by "fails"."""
    calls: list[str] = []

    @contextmanager
    def beside(lists, listen, more):
        fails = "fails" in calls
        calls.extend(call.partition(" ")[0].rpartition(":")[2] for each in lists for call in each)
        succeeded = []
        yield succeeded
        succeeded += [True, not fails]

    monkeypatch.setattr(ahead, "compiling_beside", beside)
    return calls


def warm(policy="random", **overrides):
    with warming_up([policy], overrides):
        pass


def test_nothing_is_started_where_the_same_warm_up_came_to_its_end(room, started):
    warm(), warm()
    assert started == ["compile_map", "sensing", "motion", "views", "play"]
    warm("pixel_only")  # asks for more features
    warm(**{"sensor.depth_noise": "kinect"})
    assert len(started) == 15
    started[:] = ["fails"]
    warm(**{"sensor.depth_noise": "none"}), warm(**{"sensor.depth_noise": "none"})
    assert len(started) == 11


def test_the_mark_holds_for_the_same_sources_settings_and_kernels_only(room, started, monkeypatch):
    def marked() -> bool:
        return is_current(completion_marker(smallest_job(["random"], {})))

    kernel = room / "__pycache__" / "module.kernel-1.kernel"
    assert not marked()
    warm()
    assert marked() and not is_current(completion_marker(smallest_job(["pixel_only"], {})))
    (room / "__pycache__" / "module.other-2.kernel").touch()  # what is compiled later does no harm
    assert marked()
    with monkeypatch.context() as patch:
        patch.setenv("NUMBA_CPU_NAME", "generic")
        assert not marked()
    kernel.rename(room / "elsewhere")
    assert not marked()
    (room / "elsewhere").rename(kernel)
    assert marked()
    kernel.write_bytes(b"")  # damaged
    assert not marked()
    files.write(kernel, bytes(32), b"compiled again")
    assert marked()
    os.utime(room / "module.py", (1, 1))
    assert not marked()


def test_no_mark_for_what_lies_outside_or_cannot_be_kept(room, monkeypatch):
    mine = type("Mine", (Policy,), {"__module__": "my_package", "act": lambda *_: 0})
    monkeypatch.setitem(POLICIES._entries, "mine", mine)
    assert completion_marker(smallest_job(["mine"], {})) is None
    assert completion_marker(smallest_job(["random"], {"features": "my_package:gain"})) is None
    assert completion_marker(smallest_job(["random"], {})) is not None
    monkeypatch.setattr(files, "cache_place", lambda: None)
    assert completion_marker(smallest_job(["random"], {})) is None


def test_the_folders_are_those_with_kernels():
    names = {file.name for folder in files.package_folders() for file in folder.rglob("*.py")}
    assert {"kernels.py", "windows.py", "reconstruction_env.py", "greedy.py"} <= names


def test_a_kernel_counts_once_whichever_process_compiles_it():
    said = []
    tally = Tally(said.append)
    for name in ("room.one", "room.two", "room.one"):
        tally(name)
    tally.conclude()
    assert said[0] == progress.begin() and said[-1].startswith("compiled 2 kernels in ")
    counts = [line.rpartition(",")[0] for line in said[1:-1]]
    assert counts == [f"compiling kernels, once per installation: {number} so far" for number in (1, 2, 2)]
    said.clear()
    tally = Tally(said.append, {"room.one", "room.two", "room.three"})
    for name in ("room.one", "mine.one"):  # a kernel of the user's own is one more
        tally(name)
    counts = [line.rpartition(": ")[2].rpartition(",")[0] for line in said[1:]]
    assert counts == ["1 of 3", "2 of 4"]
    said.clear()
    Tally(said.append).conclude()  # nothing had to be compiled
    assert said == []


def test_every_feature_of_every_policy_is_asked_for():
    found = all_features(["random", "pixel_only", "activestructure", "pixel_only"])
    assert found == ["deficiency", "pixel", "unknown_volume_way"]


def test_both_processes_do_their_part_of_the_work(monkeypatch):
    from activestructure_gym import envs, first_use
    from activestructure_gym.evaluation.running import episode

    done = []

    class Env:
        def __init__(self, **options):
            done.append(options["features"])

        step = close = reset = lambda self, *_, **__: None

    monkeypatch.setattr(first_use, "map_making", lambda: done.append("map"))
    monkeypatch.setattr(episode, "run_job", lambda job, place: done.append(job.policy))
    monkeypatch.setattr(envs, "ReconstructionEnv", Env)
    compile_map()
    play({"job": smallest_job(["random", "pixel_only"], {}).as_dict(), "features": ["hole_area", "pixel"]})
    assert done == ["map", "pixel_only", ["hole_area", "pixel"]]
    assert callable(warmup.warming_up)
