"""What is kept of the code of others, and what of it is seen to have changed."""

from __future__ import annotations

import os
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from activestructure_gym import registry
from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.plugin_code import changed_code, checksum_of, is_unchanged, plugin_code_of


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_what_is_registered_here_a_checkpoint_a_reference_and_a_scene_have_none():
    for policy in ("hole_area", "active_gs?travel=shared", "learned:runs/mine", "reference:oracle", "trajectory:x.npz"):
        assert plugin_code_of(Job("my_scenes:cube", policy, 0), str) == {}
    assert (
        plugin_code_of(
            Job(
                "room?seed=3", "random", 0, conditions=Conditions(overrides=(("features", ("pixel", "naruto_look_x")),))
            ),
            str,
        )
        == {}
    )


def test_every_own_thing_is_summed_and_none_is_imported(here: Path):
    for name in ("mine_b", "mine_c", "mine_d", "mine_m"):
        (here / f"{name}.py").write_text(f"raise AssertionError('{name}')\n")
    stages = [["pool", "mine_d:views"]]
    changes = {"features": ("pixel", "mine_c:gain"), "views.stages": stages, "mapper.name": "mine_m:Config"}
    job = Job("box", "mine_b:Mine?depth=2", 0, conditions=Conditions(overrides=changes))
    found = plugin_code_of(job, checksum_of)
    assert list(found) == [
        "policy mine_b:Mine?depth=2",
        "feature mine_c:gain",
        "candidate source mine_d:views",
        "mapper mine_m:Config",
    ]
    assert len(set(found.values())) == 4 and all(len(total) == 64 for total in found.values())
    assert not {"mine_b", "mine_c", "mine_d", "mine_m"} & sys.modules.keys()


def test_of_a_package_every_python_file_counts_with_its_name_and_nothing_else(here: Path):
    (here / "kit" / "deep").mkdir(parents=True)
    for name in ("__init__", "plan", "deep/__init__", "deep/more"):
        (here / "kit" / f"{name}.py").write_text("x = 1\n")
    checksums = [checksum_of("kit")]
    (here / "kit" / ".#plan.py").symlink_to("nobody@nowhere.1")  # an editor's, of a file that is not saved yet
    for name in ("notes.txt", ".venv/lib.py", "site-packages/other.py", "runs/compare.json", "runs/jobs/config.py"):
        (here / "kit" / name).parent.mkdir(exist_ok=True, parents=True)
        (here / "kit" / name).write_text("x = 2\n")
        assert checksum_of("kit") == checksums[0], name
    for name in ("deep/more.py", "__init__.py"):
        (here / "kit" / name).write_text("x = 2\n")
        checksums.append(checksum_of("kit"))
    (here / "kit" / "plan.py").rename(here / "kit" / "plans.py")
    assert len({*checksums, checksum_of("kit")}) == 4


def test_a_folder_without_init_is_the_same_however_often_it_is_on_the_path(here: Path, monkeypatch):
    (here / "loose").mkdir()
    (here / "loose" / "plan.py").write_text("x = 1\n")
    once = checksum_of("loose")
    monkeypatch.setattr(sys, "path", [str(here), str(here / ".." / here.name), *sys.path])
    assert once is not None and checksum_of("loose") == once


def test_an_installed_one_is_known_by_its_entry_point_unless_ours_has_its_name(here: Path, monkeypatch):
    (here / "installed_one.py").write_text("x = 1\n")
    points = [EntryPoint(name, "installed_one:Any", "activestructure_gym.policies") for name in ("area", "hole_area")]
    monkeypatch.setattr(registry, "installed", lambda group: points if group == points[0].group else [])
    assert list(plugin_code_of(Job("box", "area?depth=3", 0), checksum_of)) == ["policy area?depth=3"]
    assert plugin_code_of(Job("box", "hole_area", 0), checksum_of) == {}
    assert plugin_code_of(Job("box", "activestructure_gym.policies.random:Random", 0), checksum_of) == {}


def test_an_installed_feature_is_known_by_its_columns_too(here: Path, monkeypatch):
    (here / "installed_two.py").write_text("x = 1\n")
    point = EntryPoint("two", "installed_two:two", "activestructure_gym.features")
    monkeypatch.setattr(registry, "installed", lambda group: [point] if group == point.group else [])
    for name, found in (("two", 1), ("two_left_eye", 1), ("naruto_look_x", 0), ("pixel", 0), ("three_x", 0)):
        assert (
            len(
                plugin_code_of(
                    Job("box", "random", 0, conditions=Conditions(overrides=(("features", (name,)),))), checksum_of
                )
            )
            == found
        ), name


def test_what_cannot_be_found_is_left_out():
    for name in ("nowhere_to_be_found", "sys", "", "..", "no/module"):
        assert checksum_of(name) is None, name


def test_a_file_that_cannot_be_read_does_not_hide_the_others(here: Path):
    (here / "half").mkdir()
    (here / "half" / "gone.py").symlink_to("nowhere")
    (here / "half" / "plan.py").write_text("x = 1\n")
    first = checksum_of("half")
    (here / "half" / "plan.py").write_text("x = 2\n")
    assert first is not None and checksum_of("half") not in (None, first)


def test_runs_without_a_sum_count_as_equal_and_those_that_cannot_be_read_do_not(here: Path):
    run, job = here / "run", Job("box", "mine_e:Mine", 0)
    run.mkdir()
    now = {"mine_e": "b" * 64}.get
    for content, changed in (({}, []), ({"own_code": {}}, []), ({"own_code": {"policy mine_e:Mine": "b" * 64}}, []),
                             ({"own_code": {"policy mine_e:Mine": "a" * 64}}, ["policy mine_e:Mine"])):  # fmt: skip
        json_files.write_json(run / store.CONFIG, content)
        assert changed_code(run, job, now) == changed
    assert changed_code(run, job, lambda module: None) == []  # the module is gone: nobody can say
    for damaged in ("{", "[]", '{"own_code": "x"}', '{"own_code": {"a": 1}}'):
        (run / store.CONFIG).write_text(damaged)
        assert changed_code(run, job, now) == ["policy mine_e:Mine"] and not is_unchanged(run, job, now)


def test_what_the_policy_brings_counts_too(here: Path):
    """Its features, sources and mapper, which the configuration of the run names."""
    run, job = here / "run", Job("box", "mine_h:Mine", 0)
    run.mkdir()
    configuration = {
        "features": ["mine_i:gain"], "mapper": {"name": "mine_j:Config"}, "views": {"stages": [["mine_k:Near?m=1"]]}
    }  # fmt: skip
    checksums = dict.fromkeys(("mine_h", "mine_i", "mine_j", "mine_k"), "a" * 64)
    own = plugin_code_of(job, checksums.get, configuration)
    assert len(own) == 4
    json_files.write_json(run / store.CONFIG, {"own_code": own, "configuration": configuration})
    assert changed_code(run, job, checksums.get) == [] and is_unchanged(run, job, checksums.get)
    for module, part in (("mine_i", "feature"), ("mine_j", "mapper"), ("mine_k", "candidate source")):
        (changed,) = changed_code(run, job, {**checksums, module: "b" * 64}.get)
        assert changed.startswith(part) and not is_unchanged(run, job, {**checksums, module: "b" * 64}.get)


def test_a_run_is_as_it_was_only_where_all_its_own_code_is_there(here: Path):
    run, job = (
        here / "run",
        Job("box", "mine_f:Mine", 0, conditions=Conditions(overrides=(("features", ("mine_g:gain",)),))),
    )
    run.mkdir()
    checksums = {"mine_f": "a" * 64, "mine_g": "b" * 64}
    json_files.write_json(run / store.CONFIG, {"own_code": plugin_code_of(job, checksums.get)})
    assert is_unchanged(run, job, checksums.get)
    assert not is_unchanged(run, job, {"mine_f": "a" * 64}.get)
    assert not is_unchanged(run, job, {**checksums, "mine_g": "c" * 64}.get)
    json_files.write_json(run / store.CONFIG, {})
    assert not is_unchanged(run, job, {}.get)


def test_a_withdrawn_run_can_be_reinstated(tmp_path: Path):
    (tmp_path / completion.DONE).write_text("mark")
    completion.withdraw(tmp_path)
    completion.withdraw(tmp_path)  # as another program may do at the same time
    assert completion.is_withdrawn(tmp_path) and not (tmp_path / completion.DONE).exists()
    completion.reinstate(tmp_path)
    completion.reinstate(tmp_path)
    assert (tmp_path / completion.DONE).read_text() == "mark" and os.listdir(tmp_path) == [completion.DONE]
