"""The frames of a run in a scene are drawn at any size; those of a run in a world are the captured ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import CAPTURES, Run
from activestructure_gym.evaluation.export import posed_frames


def test_keyframes_are_drawn_with_exact_depth(run: Run) -> None:
    from activestructure_gym.scenes import load_scene

    frames = posed_frames(run, size=(40, 30))
    assert frames.numbers.tolist() == run.trajectory["keyframes"].tolist() and len(frames) > 3
    raycaster = load_scene("box").raycaster
    for pose, (rgb, depth) in zip(frames.world_from_camera, frames.images(), strict=True):
        assert rgb.shape == (30, 40, 3) and rgb.dtype == np.uint8
        rays = (frames.camera.rays().reshape(-1, 3) @ pose[:3, :3].T).astype(np.float32)
        hit = raycaster.cast(pose[:3, 3].astype(np.float32), rays).distance
        np.testing.assert_allclose(depth.ravel(), hit, atol=1e-4)


def test_all_frames_are_all_executed_poses(run: Run) -> None:
    frames = posed_frames(run, "all", (8, 6))
    np.testing.assert_array_equal(frames.world_from_camera, run.trajectory["world_from_camera"])
    assert len(list(frames.images())) == len(frames) == len(run.trajectory["world_from_camera"])


def test_depth_ends_at_the_range_of_the_sensor(run: Run) -> None:
    near = dataclasses.replace(run)
    near.__dict__["trajectory"] = {**run.trajectory, "max_range": np.array(1.0)}
    shown = np.stack([depth for _, depth in posed_frames(run, size=(16, 12)).images()])
    kept = np.stack([depth for _, depth in posed_frames(near, size=(16, 12)).images()])
    np.testing.assert_array_equal(kept, np.where(shown <= 1.0, shown, 0.0))
    assert 0 < (kept > 0).sum() < (shown > 0).sum()


def test_a_world_has_the_frames_that_it_captured(world_run: Run) -> None:
    frames = posed_frames(world_run)
    files = sorted((world_run.directory / CAPTURES).glob("0*.npz"))
    assert len(files) == len(frames) and (frames.camera.width, frames.camera.height) == (48, 36)
    for file, pose, (rgb, depth) in zip(files, frames.world_from_camera, frames.images(), strict=True):
        with np.load(file) as stored:
            np.testing.assert_array_equal(rgb, stored["rgb"])
            np.testing.assert_array_equal(depth[depth > 0], stored["depth"][depth > 0])
            np.testing.assert_array_equal(pose, stored["pose"])


@pytest.mark.parametrize(
    ("chosen", "size", "message"),
    [("all", None, "captured images at its keyframes only"), ("keyframes", (96, 72), "48 x 36 pixels and cannot be")],
)
def test_a_world_cannot_draw_again(world_run: Run, chosen: str, size: tuple[int, int] | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        posed_frames(world_run, chosen, size)  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [(0, 10), (9000, 10), (8000, 2)])
def test_a_size_must_be_plausible(run: Run, size: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="1 to 8192 pixels per side"):
        posed_frames(run, size=size)


def test_the_code_of_a_scene_runs_only_if_trusted(run: Run) -> None:
    job = dataclasses.replace(run.job, scene="os:getcwd")
    with pytest.raises(InputError, match="os:getcwd"):
        posed_frames(dataclasses.replace(run, job=job))
