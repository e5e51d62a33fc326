"""What is kept of the code of others, and what of it is seen to have changed."""

from __future__ import annotations

import hashlib
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from activestructure_gym import registry
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.own_code import own_code


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_what_is_registered_here_a_file_a_checkpoint_and_a_reference_have_none():
    for policy in ("hole_area", "active_gs?travel=shared", "learned:runs/mine", "reference:oracle", "trajectory:x.npz"):
        assert own_code(Job("box", policy, 0)) == {}
    assert own_code(Job("room?seed=3", "random", 0, overrides=(("gains", ("pixel",)),))) == {}


def test_every_own_thing_is_summed_and_none_is_imported(here: Path):
    for name in ("mine_a", "mine_b", "mine_c", "mine_d"):
        (here / f"{name}.py").write_text(f"raise AssertionError('{name}')\n")
    job = Job(
        "mine_a:cube?side=5", "mine_b:Mine?depth=2", 0,
        overrides=(("gains", ("pixel", "mine_c:gain")), ("views.stages", [["pool", "mine_d:views"]])),
    )  # fmt: skip
    found = own_code(job)
    assert found == {
        f"{kind} {name}": hashlib.sha256((here / f"{module}.py").read_bytes() + b"\0").hexdigest()
        for kind, name, module in (
            ("scene", "mine_a:cube?side=5", "mine_a"), ("policy", "mine_b:Mine?depth=2", "mine_b"),
            ("feature", "mine_c:gain", "mine_c"), ("candidate source", "mine_d:views", "mine_d"),
        )
    }  # fmt: skip
    assert not {"mine_a", "mine_b", "mine_c", "mine_d"} & sys.modules.keys()


def test_of_a_package_every_file_counts_and_nothing_else(here: Path):
    (here / "kit" / "deep").mkdir(parents=True)
    for name in ("__init__", "plan", "deep/__init__", "deep/more"):
        (here / "kit" / f"{name}.py").write_text("x = 1\n")
    job, sums = Job("box", "kit.plan:Mine", 0), []
    for name in (None, "notes.txt", "deep/more.py", "__init__.py"):
        if name:
            (here / "kit" / name).write_text("x = 2\n")
        sums.append(own_code(job)["policy kit.plan:Mine"])
    assert sums[0] == sums[1] and len(set(sums)) == 3


def test_an_installed_one_is_known_by_its_entry_point(here: Path, monkeypatch: pytest.MonkeyPatch):
    (here / "installed_one.py").write_text("x = 1\n")
    point = EntryPoint("area_first", "installed_one:AreaFirst", "activestructure_gym.policies")
    monkeypatch.setattr(registry, "entry_points", lambda *, group: [point] if group == point.group else [])
    assert list(own_code(Job("box", "area_first?depth=3", 0))) == ["policy area_first?depth=3"]
    assert own_code(Job("box", "hole_area", 0)) == {}


def test_what_cannot_be_found_is_left_out(here: Path):
    for name in ("nowhere_to_be_found:Mine", "nowhere.to.be.found:Mine", "sys:Mine", "__main__:Mine"):
        assert own_code(Job("box", name, 0)) == {}
