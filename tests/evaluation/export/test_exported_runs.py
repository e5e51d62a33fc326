"""``asg export`` on real runs: whole folders, or nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.export import dataset


def names(folder: Path) -> list[str]:
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


@pytest.mark.parametrize("form", ["colmap", "nerfstudio"])
def test_a_data_set_is_one_folder(
    run: Run, form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["export", str(run.directory), "--format", form, "--size", "32x24", "--frames", "all"]
    assert main(command) == 0
    frames = [f"frame_{number:06d}.png" for number in range(len(run.trajectory["world_from_camera"]))]
    pictures = [f"{kind}/{name}" for kind in ("depth", "images") for name in frames]
    model = {
        "colmap": ["sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt"],
        "nerfstudio": ["sparse_pc.ply", "transforms.json"],
    }[form]
    assert names(tmp_path / form) == sorted([*pictures, *model])
    assert f"{form}: {len(frames)} pictures of 32 x 24 pixels with depth and " in capsys.readouterr().out
    assert main(command) == 2 and "exists already" in capsys.readouterr().err
    assert names(tmp_path / form) == sorted([*pictures, *model])


def test_a_run_in_a_world_is_exported_from_its_captures(
    world_run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["export", str(world_run.directory), "--format", "nerfstudio", "--out", str(tmp_path / "data")]
    assert main([*command, "--size", "96x72"]) == 2
    assert "leave out --size" in capsys.readouterr().err and not (tmp_path / "data").exists()
    assert main(command) == 0
    assert len(list((tmp_path / "data/images").iterdir())) == len(world_run.trajectory["keyframes"])


def test_nothing_is_left_of_an_export_that_fails(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise InputError("no seeds")

    monkeypatch.setattr(dataset, "_write_points", fails)
    (tmp_path / "empty").mkdir()
    for name in ("new", "empty"):
        command = ["export", str(run.directory), "--format", "nerfstudio", "--size", "8x6"]
        assert main([*command, "--out", str(tmp_path / name)]) == 2
    assert list(tmp_path.rglob("*")) == [tmp_path / "empty"]


def test_a_mesh_has_its_formats_up_axis(run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options in (["--out", "a.glb"], ["--out", "a.ply", "--format", "mesh"], ["--out", "b.glb", "--up", "z"]):
        options[1] = str(tmp_path / options[1])
        assert main(["export", str(run.directory), *options]) == 0
    said = [line.rpartition(", ")[2] for line in capsys.readouterr().out.splitlines() if "triangles of box" in line]
    assert said == ["y up", "z up", "z up"]
    glb, ply, turned = (trimesh.load(tmp_path / name, force="mesh").bounds for name in ("a.glb", "a.ply", "b.glb"))
    np.testing.assert_allclose(glb[:, 1], ply[:, 2], atol=1e-5)
    np.testing.assert_allclose(turned, ply, atol=1e-5)
