"""A native run is known by what its policy brings, which its job does not say."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym.config import configure
from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.native_settings_diff import changed_native_settings
from activestructure_gym.evaluation.running.resuming import review_finished
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.native_settings import NativeSettings

JOB = Job(
    "box", "activegamer", 0, conditions=Conditions(preset="full", setup="native", overrides=(("keyframe_every", 7),))
)


def write(place: Path, job: Job = JOB, **changes: Any) -> Path:
    """What a run of today says of its configuration, with changes."""
    place.mkdir(exist_ok=True, parents=True)
    config = configure(job.conditions.preset, job.conditions.changes(POLICIES.get(job.policy)) | changes)
    json_files.write_json(place / store.CONFIG, {"configuration": json_files.plain(dataclasses.asdict(config))})
    return place


def test_fields_that_a_schedule_sets_otherwise_today_are_named(tmp_path: Path) -> None:
    assert changed_native_settings(write(tmp_path), JOB) == []
    assert changed_native_settings(write(tmp_path, **{"mapper.iterations": 10}), JOB) == ["mapper.iterations"]
    then = write(tmp_path, **{"views.stages": (("pool",),), "views.max_candidates": 256, "sensor.width": 64})
    assert changed_native_settings(then, JOB) == ["views.stages", "views.max_candidates"]  # the width is the preset's


def test_what_was_asked_for_is_no_change_of_the_schedule(tmp_path: Path) -> None:
    assert configure("full", JOB.conditions.changes(POLICIES.get("activegamer"))).keyframe_every == 7
    asked = dataclasses.replace(JOB, conditions=dataclasses.replace(JOB.conditions, overrides={"mapper.iterations": 3}))
    assert changed_native_settings(write(tmp_path, asked), asked) == []


def test_shared_terms_own_code_and_what_cannot_be_read_have_none(tmp_path: Path) -> None:
    old = write(tmp_path, **{"mapper.iterations": 10})
    for changes in (
        {"conditions": dataclasses.replace(JOB.conditions, setup="shared")},
        {"policy": "mine:Mine"},
        {"policy": "learned:model"},
        {"policy": "trajectory:x"},
    ):
        assert changed_native_settings(old, dataclasses.replace(JOB, **changes)) == [], changes
    (old / store.CONFIG).write_text("{")
    assert changed_native_settings(old, JOB) == []
    json_files.write_json(old / store.CONFIG, {})
    assert changed_native_settings(old, JOB) == []


def test_a_run_of_another_schedule_is_played_again_and_counts_where_that_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "damage_of", lambda place, job: None)
    place, told = write(tmp_path / completion.JOBS / JOB.name), []
    (place / completion.DONE).write_text(JOB.hash)

    def go_on(asked: tuple[str, ...] = (JOB.name,)) -> list[str]:
        told.clear()
        review_finished([JOB], asked, tmp_path, told.append)
        return told

    assert go_on() == [] and completion.is_done(place, JOB)
    with monkeypatch.context() as patch:
        patch.setattr(POLICIES.get("activegamer"), "native_settings", NativeSettings(mapper="splatam", iterations=2))
        assert go_on(()) == [
            f"1 run with the native settings of activegamer ({FIELDS}) stays, though its code has changed since"
        ]
        assert completion.is_done(place, JOB)
        assert go_on() == [
            f"1 run with the native settings of activegamer ({FIELDS}) is played again: its code has changed since"
        ]
        assert completion.is_withdrawn(place)
        assert go_on() == [] and completion.is_withdrawn(place)
    assert go_on() == [] and completion.is_done(place, JOB)


FIELDS = "mapper.iterations, views.stages, views.max_candidates, motion.candidate_clearance"


def test_chance_on_the_views_of_own_code_imports_none_of_it(tmp_path: Path) -> None:
    job = Job("box", "random?views_of=this:Zen", 0, conditions=Conditions(setup="native", preset="fast"))
    assert changed_native_settings(tmp_path, job) == [] and "this" not in sys.modules
