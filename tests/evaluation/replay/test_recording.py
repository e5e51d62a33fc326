"""A run played again is the run: same frames, same map, and who was there when."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.references.trajectory import named_trajectory
from activestructure_gym.evaluation.replay import Recording, play_again
from activestructure_gym.evaluation.replay.recording import replay_env
from activestructure_gym.evaluation.running.episode import run_job
from activestructure_gym.specs import Spec


def test_the_map_at_the_end_is_the_stored_one(finished: list[Run], recordings: list[Recording]) -> None:
    for run, recording in zip(finished, recordings):
        assert recording.divergence == ""
        last = recording.gaussians[:, recording.removed > 40]
        stored = run.gaussians.parameters[:, : run.gaussians.count]
        assert last.shape == stored.shape
        np.testing.assert_array_equal(last[:, np.lexsort(last)], stored[:, np.lexsort(stored)])
        np.testing.assert_array_equal(recording.poses, run.trajectory["world_from_camera"])


def test_a_reference_in_the_native_setup_is_played_with_the_overrides_alone(finished: list[Run]) -> None:
    job = finished[0].job
    native = replace(job, policy=Spec("reference:oracle"), conditions=replace(job.conditions, setup="native"))
    with replay_env(replace(finished[0], job=native)) as env:
        assert env.reconstruction.frames == 1


def test_everybody_is_born_with_a_keyframe_and_the_first_ones_come_first(recordings: list[Recording]) -> None:
    for recording in recordings:
        keyframes = recording.run.trajectory["keyframes"] + 1  # frames paid when each was taken
        assert set(np.unique(recording.added)) <= set(keyframes.tolist())
        assert (np.diff(recording.added) >= 0).all() and (recording.removed > recording.added).all()
        counts = {step["frames"]: step["gaussians"] for step in recording.run.steps}
        for frame, count in counts.items():
            assert ((recording.added <= frame) & (recording.removed > frame)).sum() == count


def test_a_moment_shows_what_there_was_to_decide_by(recordings: list[Recording]) -> None:
    for recording in recordings:
        steps, moments = recording.run.steps, recording.moments
        assert len(moments) == len(steps) + 1 and moments[-1].row == -1
        for step, moment in zip(steps, moments):
            assert len(moment.candidates) == step["candidates"]
            np.testing.assert_allclose(moment.candidates[moment.row], list(step["view"].values())[:8], atol=1e-5)
            assert len(moment.planes) == len(moment.structural) == len(moment.centroids)
        image = cv2.imdecode(np.frombuffer(moments[0].true, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (54, 96, 3) and image.std() > 5
    greedy = next(one for one in recordings if one.run.policy == "hole_area")
    aimless = next(one for one in recordings if one.run.policy == "random")
    assert greedy.moments[0].scores.max() > 0 and np.isnan(aimless.moments[0].scores).all()


def test_a_trajectory_that_was_followed_is_watched_without_choices(finished: list[Run], tmp_path: Path) -> None:
    job = replace(finished[0].job, policy=named_trajectory(f"trajectory:{finished[0].directory}"))
    run = run_job(job, tmp_path / "run")
    recording = play_again(run)
    assert recording.divergence == "" and {moment.row for moment in recording.moments} == {-1}
    np.testing.assert_array_equal(recording.poses, finished[0].trajectory["world_from_camera"])


@pytest.mark.slow
def test_a_difference_from_the_stored_run_is_reported(finished: list[Run], tmp_path: Path) -> None:
    run = finished[0]
    shutil.copytree(run.directory, tmp_path / "run")
    changed = replace(run, directory=tmp_path / "run")
    changed.__dict__["steps"] = [{**step, "gaussians": step["gaussians"] + (n > 0)} for n, step in enumerate(run.steps)]
    assert play_again(changed).divergence.startswith("the replay differs from the stored run from decision 1 on")
    changed.__dict__["steps"] = [*run.steps, {**run.steps[-1], "decision": len(run.steps)}]
    assert play_again(changed).divergence.endswith("but the stored run continues")


def test_files_that_name_code_are_not_played_unless_trusted(finished: list[Run]) -> None:
    run = finished[0]

    def with_job(**changes: Any) -> Run:
        return replace(run, job=replace(run.job, **changes))

    other = "tests.policies.test_native_settings:Bringer"
    for untrusted, what in (
        (with_job(scene="pathlib:Path"), "scene"),
        (with_job(policy=other, conditions=replace(run.job.conditions, setup="native")), "policy"),
        (with_job(conditions=Conditions(overrides={"views.stages": (("pathlib:Path",),)})), "candidate source"),
    ):
        with pytest.raises(InputError, match=f"config.json' names the {what} .* add --trust-code"):
            play_again(untrusted)
    # In the shared setup the actions are stored and the policy is not made: nothing of it is loaded.
    again = play_again(with_job(policy=other))
    np.testing.assert_array_equal(again.poses, run.trajectory["world_from_camera"])
