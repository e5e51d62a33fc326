"""Trajectories as jobs: a run's own gives the run's map, another's is measured as it is or refused."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import StandardProtocol, compare
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, policy_label, refuse_code
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.references.trajectory import TrajectorySpec, named_trajectory, with_mappers
from activestructure_gym.evaluation.report.page.method_text import trajectories_text
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.evaluation.trajectories.formats import read_poses, read_recorded
from activestructure_gym.geometry import look_along
from activestructure_gym.specs import Spec

PROTOCOL = replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000)
CONFIG = {"mapper.iterations": 2, "keyframe_every": 5, "views.max_revisits": 4}
USUAL: dict[str, Any] = {"conditions": Conditions("fast", 40, CONFIG, protocol=PROTOCOL), "engine": "inline"}


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Run:
    (run,) = compare(
        ["box"],
        ["random"],
        tmp_path_factory.mktemp("played") / "runs",
        **USUAL,
    ).runs
    return run


def test_a_run_scored_by_its_own_trajectory_is_the_same_run(played: Run, tmp_path: Path) -> None:
    spec = f"trajectory:{played.directory / 'trajectory.npz'}"
    result = compare(["box"], [spec, "random"], tmp_path / "runs", **USUAL)
    again = next(run for run in result.runs if run.job.policy.kind == "trajectory")
    assert again.policy.startswith("trajectory:random--seed0@")
    for file in ("map.npz", "map.ply", "graph.npz", "trajectory.npz"):
        assert (again.directory / file).read_bytes() == (played.directory / file).read_bytes(), file
    numbers, before = again.metrics["metrics"], played.metrics["metrics"]
    assert {name: numbers[name] for name in before} == before
    assert again.metrics["curve"] == played.metrics["curve"]
    assert (numbers["steps_too_long"], numbers["turns_too_wide"], numbers["poses_outside"]) == (0, 0, 0)
    kept = compare(["box"], [spec], tmp_path / "runs", resume=True, **USUAL)
    assert kept.skipped == 1 and not kept.failed
    assert again.decisions is None and played.decisions is not None  # a trajectory compares no scores


def write(place: Path, poses: np.ndarray) -> Path:
    place.write_text("\n".join(" ".join(f"{value:.17g}" for value in pose.ravel()) for pose in poses))
    return place


def flown(start: np.ndarray) -> np.ndarray:
    """Six poses on the spot that turn by 15 degrees each."""
    angles = np.radians(15.0 * np.arange(6))
    return np.stack([look_along(start[:3, 3], np.array([np.cos(a), np.sin(a), 0.0])) for a in angles])


def test_what_a_trajectory_does_beyond_the_limits_is_told(played: Run, tmp_path: Path) -> None:
    poses = flown(played.trajectory["world_from_camera"][0])
    poses[3:, :3, 3] += [0.0, 0.0, 0.15]
    file = write(tmp_path / "poses.txt", poses)
    (run,) = compare(
        ["box"],
        [f"trajectory:{file}?mapper=splatam"],
        tmp_path / "runs",
        **USUAL,
    ).runs
    numbers = run.metrics["metrics"]
    assert (numbers["frames"], numbers["ended"]) == (6, "the trajectory has ended")
    assert (numbers["steps_too_long"], numbers["turns_too_wide"], numbers["collisions"]) == (1, 5, 0)
    assert numbers["largest_step_m"] == pytest.approx(0.15) and numbers["largest_turn_deg"] == pytest.approx(15.0)
    assert run.config["configuration"]["mapper"]["name"] == "splatam"
    assert run.trajectory["keyframes"].tolist() == [0, 4, 5]
    (told,) = trajectories_text(gather([tmp_path / "runs"]))
    assert "6 frames) 0 collisions, 0 poses outside free space, 1 steps over 0.1 m (largest 0.15 m)" in told
    assert "5 turns over 10 degrees (largest 15)" in told
    assert run.policy.startswith(f"trajectory:{tmp_path.name}@") and run.policy.endswith("?mapper=splatam")


def test_a_wrong_convention_is_refused_before_anything_runs(played: Run, tmp_path: Path) -> None:
    poses = flown(played.trajectory["world_from_camera"][0])
    poses[:, :3, 1:3] *= -1  # as OpenGL has them
    file = write(tmp_path / "poses.txt", poses)
    with pytest.raises(InputError, match="the most likely convention is --axes opengl"):
        Comparison(["box"], [f"trajectory:{file}"], conditions=Conditions(preset="fast")).prepare()
    relative = write(tmp_path / "relative.txt", np.linalg.inv(poses[0]) @ poses)
    with pytest.raises(InputError, match="give its pose by --start x,y,z,yaw"):
        Comparison(["box"], [f"trajectory:{relative}"], conditions=Conditions(preset="fast")).prepare()


def test_a_trajectory_has_one_name_and_is_known_by_its_content(played: Run, tmp_path: Path) -> None:
    file = write(tmp_path / "way.txt", flown(np.eye(4)))
    spec = named_trajectory(f"trajectory:{file}?axes=opencv&format=nice_slam&mapper=splatam")
    assert (
        spec == named_trajectory(spec) and spec.startswith(f"trajectory:{file}@") and spec.endswith("?mapper=splatam")
    )
    assert policy_label(spec) == f"trajectory:way@{spec.partition('@')[2]}"
    refuse_code([Job("box", spec, 0)], "a file")
    assert TrajectorySpec.of(spec).frames == 6
    exactly = named_trajectory(f"trajectory:{file}?start=1.23456789,0,1e+1,90")
    assert exactly.endswith("?start=1.23456789,0,10,90") and TrajectorySpec.of(exactly).start == (
        1.23456789,
        0.0,
        10.0,
        90.0,
    )
    write(file, flown(np.eye(4))[:3])
    with pytest.raises(InputError, match=r"way.txt' has changed: expected"):
        named_trajectory(spec)
    with pytest.raises(InputError, match="unknown mapper 'splatan'; did you mean 'splatam'"):
        named_trajectory(f"trajectory:{file}?mapper=splatan")
    with pytest.raises(InputError, match="which separate options: rename it"):
        named_trajectory(f"trajectory:{shutil.copy(file, tmp_path / 'a&b.txt')}")


def test_a_trajectory_in_its_own_frame_is_aligned_mapped_and_compared(played: Run, tmp_path: Path) -> None:
    reference = flown(played.trajectory["world_from_camera"][0])
    reference[:, :3, 3] += 0.05 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]])
    away = look_along(np.array([3.0, -2.0, 9.0]), np.array([0.0, 1.0, 0.0]))
    own = away @ reference
    own[:, :3, 3] = own[:, :3, 3] * 2.0
    own[-1, :3, 3] += 0.01
    files = [write(tmp_path / "own.txt", own), write(tmp_path / "reference.txt", reference), tmp_path / "list.txt"]
    files[2].write_text("1\n2\n3\n4\n")
    spec = f"trajectory:{files[0]}?reference={files[1]}&align=sim3&keyframes={files[2]}"
    (run,) = compare(["box"], [spec], tmp_path / "runs", **USUAL).runs
    numbers = run.metrics["metrics"]
    assert numbers["align_scale"] == pytest.approx(0.5, rel=0.05) and numbers["poses_matched"] == 6
    assert 1e-4 < numbers["ate_m"] < 0.01 and 0 < numbers["rpe_deg"] < 1.0
    np.testing.assert_allclose(run.trajectory["world_from_camera"][:, :3, 3], reference[:, :3, 3], atol=0.01)
    assert run.trajectory["keyframes"].tolist() == [0, 1, 2, 3, 4] and numbers["keyframes"] == 5
    (told,) = trajectories_text(gather([tmp_path / "runs"]))
    assert "5 of 6 poses mapped (from 0: 0, 1, 2, 3, 4)" in told
    assert f"ATE {numbers['ate_m']:.4f} m, RPE {numbers['rpe_m']:.4f} m and {numbers['rpe_deg']:.3f} degrees" in told
    assert f"6 poses matched to the reference, aligned with scale {numbers['align_scale']:.4f}" in told
    assert re.search(r"align=sim3&keyframes=list@[0-9a-f]{8}&reference=reference@[0-9a-f]{8}$", run.policy)
    files[2].write_text("1\n")
    with pytest.raises(InputError, match=r"list.txt' has changed: expected"):
        named_trajectory(run.job.policy)


def test_a_reference_has_the_usual_axes_of_its_own_format(tmp_path: Path) -> None:
    poses = flown(np.array([[1.0, 0, 0, 3], [0, 1, 0, 2], [0, 0, 1, 1], [0, 0, 0, 1]]))
    np.savez(tmp_path / "reference.npz", world_from_camera=poses)
    given = TrajectorySpec("way.txt", axes="habitat", reference=str(tmp_path / "reference.npz"))
    _, errors = given._compared(poses, None)
    assert errors == pytest.approx({"ate_m": 0, "rpe_m": 0, "rpe_deg": 0, "poses_matched": 6}, abs=1e-5)


def test_options_of_keyframes_and_references_are_checked(tmp_path: Path) -> None:
    file = write(tmp_path / "way.txt", flown(np.eye(4)))
    assert named_trajectory(f"trajectory:{file}?keyframes=all").endswith("?keyframes=1")
    assert [len(one.refine_factors) for one in TrajectorySpec.of(Spec(f"trajectory:{file}?keyframes=2"))._segments(
        file, "nice_slam", read_recorded(file), 99
    )] == [5]  # fmt: skip
    for options, said in (
        ("align=sim3", "an alignment needs the trajectory to align to"),
        (f"reference={file}&align=rigid", "unknown alignment 'rigid'"),
        (f"reference={file}&align=se3&start=0,0,1,0", "an alignment and a start both place the trajectory"),
        ("reference=passive", "a reference trajectory is a file of poses"),
        (f"reference={tmp_path / 'none.txt'}", "there is no trajectory"),
        ("keyframes=none.txt", "there is no list of keyframes 'none.txt'; give all, a number from 1, or a file"),
        ("keyframes=0", "keyframes must be all, a number from 1, or a file"),
    ):
        with pytest.raises(InputError, match=said):
            named_trajectory(f"trajectory:{file}?{options}")


def test_damaged_legs_are_refused(played: Run, tmp_path: Path) -> None:
    arrays = {**played.trajectory, "legs": np.array([[99, 99, 0]])}
    np.savez(tmp_path / "trajectory.npz", **arrays)
    with pytest.raises(InputError, match="is damaged: legs must rise"):
        Comparison(["box"], [f"trajectory:{tmp_path}"], conditions=Conditions(preset="fast")).prepare()


@pytest.mark.parametrize("elsewhere", [False, True])
def test_the_poses_of_a_scan_are_known_by_what_turns_them_too(tmp_path: Path, elsewhere: bool) -> None:
    (tmp_path / "scene0000_00").mkdir()
    (tmp_path / "disk").mkdir()
    pose = tmp_path / "scene0000_00" / "pose"
    pose.symlink_to(tmp_path / "disk") if elsewhere else pose.mkdir()
    np.savetxt(tmp_path / "scene0000_00" / "pose" / "0.txt", np.eye(4))
    text, line = tmp_path / "scene0000_00" / "scene0000_00.txt", " ".join(map(str, np.eye(4).ravel()))
    text.write_text(f"axisAlignment = {line}\n")
    spec = named_trajectory(f"trajectory:{tmp_path / 'scene0000_00'}")
    assert spec == named_trajectory(spec)
    text.write_text(f"axisAlignment = {line.replace('0.0', '1.5', 1)}\n")
    with pytest.raises(InputError, match="has changed"):
        named_trajectory(spec)


def test_a_sweep_is_the_same_for_every_mapper_and_starts_where_planners_do(played: Run, tmp_path: Path) -> None:
    policies = with_mappers([Spec("random"), Spec("trajectory:sweep")], ["default", "splatam"])
    assert policies == ["random", "trajectory:sweep?mapper=default", "trajectory:sweep?mapper=splatam"]
    result = compare(["box"], policies, tmp_path / "runs", **USUAL)
    random, ours, splatam = result.runs
    assert ours.trajectory["world_from_camera"].tobytes() == splatam.trajectory["world_from_camera"].tobytes()
    assert (ours.trajectory["world_from_camera"][0] == random.trajectory["world_from_camera"][0]).all()
    assert [run.config["configuration"]["mapper"]["name"] for run in (ours, splatam)] == ["default", "splatam"]
    assert ours.metrics["metrics"]["frames"] == 40 and ours.metrics["metrics"]["collisions"] == 0
    assert ours.metrics["metrics"]["gaussians"] != splatam.metrics["metrics"]["gaussians"]


def test_mappers_are_for_trajectories() -> None:
    assert with_mappers([Spec("random")], []) == ["random"]
    with pytest.raises(InputError, match="--mappers is for trajectories"):
        with_mappers([Spec("random")], ["splatam"])
    with pytest.raises(InputError, match="takes the option mapper alone"):
        named_trajectory("trajectory:sweep?axes=ros")


def test_the_sequence_that_was_recorded_with_a_scene_is_the_passive_one(shared: Path, tmp_path: Path) -> None:
    fixture = shared / "scenes" / "replica_fixture"
    scene = f"{fixture / 'room_fix'}?sequence={fixture / 'seq' / 'room_fix'}"
    (run,) = compare([scene], ["trajectory:passive"], tmp_path / "runs", **USUAL).runs
    recorded = read_poses(fixture / "seq" / "room_fix", "nice_slam")
    assert run.trajectory["world_from_camera"].tobytes() == recorded.tobytes()
    assert run.metrics["metrics"]["frames"] == 12 and run.metrics["metrics"]["steps_too_long"] > 0
    known = replace(PROTOCOL, view_source="recorded")
    with pytest.raises(InputError, match="maps the views recorded with"):
        Comparison([scene], ["trajectory:passive"], conditions=Conditions(preset="fast", protocol=known)).prepare()
    Comparison([scene], ["trajectory:sweep"], conditions=Conditions(preset="fast", protocol=known)).prepare()


def test_a_single_pose_is_a_whole_trajectory(played: Run, tmp_path: Path) -> None:
    file = write(tmp_path / "poses.txt", flown(played.trajectory["world_from_camera"][0])[:1])
    (run,) = compare(["box"], [f"trajectory:{file}"], tmp_path / "runs", **USUAL).runs
    numbers = run.metrics["metrics"]
    assert (numbers["frames"], numbers["keyframes"], numbers["metres"]) == (1, 1, 0.0)
    assert (numbers["largest_step_m"], numbers["steps_too_long"]) == (0.0, 0)
