"""Episodes with more frames than 16 bits count, and with as many as may be played."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.evaluation.archive import run_files, store
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.schema import Mismatch
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.references.trajectory import named_trajectory
from activestructure_gym.evaluation.running.api import compare
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.motion.trajectory import poses_at
from activestructure_gym.ranges import MAX_FRAMES
from activestructure_gym.scenes import load_scene

FRAMES = 70_000
CAMERA = {"intrinsics": np.array([30.0, 30, 32, 18]), "image_size": np.array([64, 36])}


def turning(frames: int) -> np.ndarray:  # [frames, 4, 4]
    """A camera that turns round in one place of the box room."""
    place = ground_truth_of(load_scene("box")).free_space.start_poses[0][:3, 3]
    return poses_at(np.tile(place, (frames, 1)), np.linspace(0, 0.003 * np.pi * frames, frames), np.zeros(frames))


def test_a_path_of_every_budget_that_is_allowed_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = np.broadcast_to(np.eye(4), (200_001, 4, 4))
    path = {"world_from_camera": poses, "keyframes": np.arange(0, 200_001, 50), **CAMERA}
    run_files.check_trajectory(path)
    assert run_files.MAX_FRAMES == MAX_FRAMES > len(poses)
    monkeypatch.setattr(run_files, "MAX_FRAMES", 200_000)
    with pytest.raises(Mismatch, match="200001 poses, at most 200000 are read"):
        run_files.check_trajectory(path)


@pytest.mark.slow
def test_an_episode_of_70_000_frames_is_kept_reported_replayed_exported_and_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "path.npz", world_from_camera=turning(FRAMES), keyframes=np.arange(0, FRAMES, 5), **CAMERA)
    result = compare(
        ["box"],
        [named_trajectory(f"trajectory:{tmp_path / 'path.npz'}")],
        tmp_path / "out",
        conditions=Conditions(
            preset="fast",
            frame_budget=FRAMES,
            overrides={"keyframe_every": 1000, "sensor.width": 64, "sensor.height": 36},
            protocol=StandardProtocol(
                views=1, view_width=64, view_height=36, surface_samples=1000, tsdf_voxel_m=0.06, tsdf_image_width=64
            ),
        ),
        engine="inline",
    )
    (run,) = result.runs
    assert run.metrics["metrics"]["frames"] == len(run.trajectory["world_from_camera"]) == FRAMES
    directory = str(run.directory)
    for words in (
        ["report", str(tmp_path / "out")],
        ["replay", directory],
        ["export", directory, "--out", str(tmp_path / "map.splat")],
        ["evaluate", directory],
        ["verify", directory],
    ):
        assert main(words) == 0, capsys.readouterr().err
    assert (run.directory / store.REPLAY).stat().st_size > 100_000
    assert "identical" in capsys.readouterr().out


@pytest.mark.slow
def test_a_log_of_70_000_decisions_is_read(tmp_path: Path) -> None:
    from activestructure_gym.evaluation.archive.json_files import json_line
    from activestructure_gym.evaluation.archive.store import read_run
    from tests.evaluation.written_runs import JOB, write_run

    directory = write_run(tmp_path / "run", JOB)
    step = {**read_run(directory).steps[0], "checkpoint": None, "view": {"x": 1.0}}
    with open(directory / store.STEPS, "w", encoding="utf-8") as file:
        file.writelines(json_line({**step, "decision": n, "frames": n + 2}) for n in range(FRAMES))
    store.finish(directory, JOB)
    steps = read_run(directory).steps
    assert len(steps) == FRAMES and steps[-1]["frames"] == FRAMES + 1
