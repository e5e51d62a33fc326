"""``asg replay-trajectory``: what is asked of a comparison, for a file and for a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.replay_trajectory import ReplayTrajectory, _asked, _run_of
from tests.evaluation.written_runs import write_run


def asked(*words: str, **options: Any) -> Any:
    given = ReplayTrajectory(*words, **options)
    return _asked(given, _run_of(given.trajectory))[1]


def test_a_file_costs_as_many_frames_as_it_has_poses(tmp_path: Path) -> None:
    (tmp_path / "way.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n" * 7)
    place = str(tmp_path / "way.txt")
    wanted = asked(place, scene="box", axes="opengl", mappers=("splatam,default",), seeds=("3",))
    assert (wanted.scenes, wanted.seeds, wanted.conditions.frame_budget) == (("box",), (3,), 7)
    assert [policy.partition("?")[2] for policy in wanted.policies] == [
        "axes=opengl&mapper=splatam",
        "axes=opengl&mapper=default",
    ]
    placed = asked(place, scene="box", keyframes="all", reference=place, align="se3").policies[0]
    assert placed.partition("?")[2].startswith(f"align=se3&keyframes=1&reference={place}@")
    with pytest.raises(InputError, match="an alignment needs the trajectory to align to"):
        asked(place, scene="box", align="se3")
    assert asked(place, scene="box", frames=5).conditions.frame_budget == 5


def test_a_run_names_its_scene_seed_and_configuration(tmp_path: Path) -> None:
    job = Job(
        "box",
        "random",
        4,
        conditions=Conditions(preset="fast", overrides=(("keyframe_every", 7), ("features", ("pixel",)))),
    )
    run = write_run(tmp_path / "run", job)
    wanted = asked(str(run), set=("revisit_rounds=2",))
    assert (wanted.scenes, wanted.seeds, wanted.conditions.preset) == (("box",), (4,), "fast")
    assert wanted.conditions.overrides == {"keyframe_every": 7, "revisit_rounds": 2}
    assert wanted.policies[0].startswith(f"trajectory:{run.resolve() / 'trajectory.npz'}@")
    with pytest.raises(InputError, match="must be at least 1, got 0"):  # it does not count as not given
        asked(str(run), frames=0)
    elsewhere = asked(str(run), scene="room")
    assert (elsewhere.scenes, elsewhere.seeds, elsewhere.conditions.overrides) == (("room",), (0,), {})


def test_what_is_missing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "poses.npz", world_from_camera=np.eye(4)[None])
    assert main(["replay-trajectory"]) == 2 and "TRAJECTORY" in capsys.readouterr().err
    assert main(["replay-trajectory", str(tmp_path / "poses.npz")]) == 2
    assert "give --scene" in capsys.readouterr().err
    assert main(["replay-trajectory", str(tmp_path / "none.txt")]) == 2
    assert "there is no trajectory" in capsys.readouterr().err
    with pytest.raises(InputError, match="unknown axes convention"):
        asked(str(tmp_path / "poses.npz"), scene="box", axes="unity").prepare()
