"""``asg export``: the format is what the file's name says, upright where the reader wants it."""

from __future__ import annotations

import os
from types import SimpleNamespace

import numpy as np
import pytest

from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.cli import main
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.files import map_kind, read_map
from activestructure_gym.mapping.gaussian_map import ROWS
from activestructure_gym.scenes.loaders.upright import which_way_is_up


class Opened(SimpleNamespace):
    gaussians = property(lambda self: GaussianMap.load_npz(self.directory / "map.npz"))


@pytest.fixture
def run(tmp_path, monkeypatch, rng):
    """A finished run in a folder of its own: 500 Gaussians; the working directory is beside it."""
    directory = tmp_path / "run"
    directory.mkdir()
    gaussians = GaussianMap(500)
    gaussians.append(rng.normal(size=(ROWS, 500)).astype(np.float32))
    gaussians.save_npz(directory / "map.npz")
    path = {
        "world_from_camera": np.tile(np.eye(4), (3, 1, 1)),
        "keyframes": np.array([0, 2]),
        "intrinsics": np.array([50.0, 50.0, 32.0, 18.0]),
        "image_size": np.array([64, 36]),
    }
    np.savez(directory / "trajectory.npz", **path)
    job = SimpleNamespace(title="room · random · seed 0")
    opened = Opened(directory=directory, job=job, trajectory=path)
    monkeypatch.setattr(store, "read_run", lambda place: opened)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return gaussians


@pytest.mark.parametrize(
    "options, name, kind",
    [
        ("", "map.ply", "ply"),
        ("--format ply", "map.ply", "ply"),
        ("--format splat", "map.splat", None),
        ("--format splatam", "params.npz", "splatam"),
        ("--out x.ply", "x.ply", "ply"),
        ("--out x.PLY --format ply", "x.PLY", "ply"),
        ("--out x.npz", "x.npz", "splatam"),
        ("--out x.splat", "x.splat", None),
        ("--out x.splat --format splat", "x.splat", None),
    ],
)
def test_the_name_says_the_format(run, tmp_path, capsys, options, name, kind):
    assert main(["export", "run", *options.split()]) == 0
    assert f"{name}: 500 Gaussians of room" in capsys.readouterr().out
    assert os.listdir() == [name]
    if kind is None:
        assert os.path.getsize(name) == 500 * 32
    else:
        assert map_kind(name) == kind


@pytest.mark.parametrize(
    "options, said",
    [
        ("--out x.splat --format ply", "--format ply is written into a .ply file, got 'x.splat'"),
        ("--out x.ply --format splatam", "--format splatam is written into a .npz file, got 'x.ply'"),
        ("--out x.png", "ends with .ply, .splat, .npz, .glb, .txt, got 'x.png'; for a folder also give --format"),
        ("--out x.ply --format tum", "--format tum is written into a .txt file, got 'x.ply'"),
        ("--out x.obj --format mesh", "--format mesh is written into a .glb or .ply file, got 'x.obj'"),
        ("--out x.ply --size 64x36", "--size is for nerfstudio and colmap: ply has no pictures"),
        ("--format colmap --size 64", "--size is width x height in pixels, such as 1200x680, got '64'"),
        ("--out x.glb --frames all", "--frames is for nerfstudio, colmap and tum: mesh has no frames"),
        ("--format colmap --up y", "--up is for maps and meshes: colmap has the scene's world, z up"),
        ("--format colmap --out full", "'full' exists already and is not an empty folder: choose another folder"),
        ("--format colmap --out nowhere/x", "there is no folder 'nowhere'"),
        ("--out x", "ends with .ply, .splat, .npz"),
        ("--out nowhere/x.ply", "there is no folder 'nowhere'"),
        (f"--out {'x' * 300}.ply", "cannot be written: File name too long"),
        ("--out taken.ply", "'taken.ply' is a folder"),
        ("--format splatam --up y", "in the frame of its first camera"),
        ("--out /proc/x.ply", "'/proc/x.ply' cannot be written"),
    ],
)
def test_what_cannot_be_written_is_one_sentence(run, capsys, options, said):
    os.mkdir("taken.ply")
    os.makedirs("full/images")
    assert main(["export", "run", *options.split()]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1 and "Traceback" not in err
    assert sorted(os.listdir()) == ["full", "taken.ply"] and os.listdir("full") == ["images"]


@pytest.mark.parametrize(
    ("options", "name", "stamps"),
    [
        ("--format tum", "trajectory.txt", [0, 1, 2]),
        ("--out p.txt", "p.txt", [0, 1, 2]),
        ("--out p.txt --frames keyframes", "p.txt", [0, 2]),
    ],
)
def test_poses_are_stamped_with_their_frame_numbers(run, capsys, options, name, stamps):
    assert main(["export", "run", *options.split()]) == 0
    assert f"{name}: {len(stamps)} poses of room" in capsys.readouterr().out
    assert np.loadtxt(name)[:, 0].tolist() == stamps and os.listdir() == [name]


@pytest.mark.parametrize("up, mean", [("z", (1, 2, 3)), ("y", (1, 3, -2)), ("-y", (1, -3, 2))])
def test_up_turns_the_map(run, capsys, up, mean):
    assert main(["export", "run", "--out", "x.ply", "--up", up]) == 0
    assert f"{up} up" in capsys.readouterr().out
    assert f"comment world frame, {up} up, metres" in open("x.ply", "rb").read(300).decode("ascii", "replace")
    axes = [abs(value) - 1 for value in mean]
    expected = run.means[:, axes] * np.sign(mean)
    np.testing.assert_array_equal(read_map("x.ply").means, expected)
    assert main(["export", "run", "--out", "x.splat", "--up", up]) == 0
    rows = np.frombuffer(open("x.splat", "rb").read(), np.uint8).reshape(-1, 32)
    means = rows[:, :12].copy().view("<f4")
    np.testing.assert_array_equal(means[np.lexsort(means.T)], expected[np.lexsort(expected.T)])


@pytest.mark.parametrize("up", ["z", "y", "-y"])
def test_a_room_stands_upright_in_the_axes_of_its_file(run, tmp_path, up):
    """The map of a furnished room, a small Gaussian on every vertex, asked the way a mesh is asked."""
    from activestructure_gym.scenes import load_scene

    mesh = load_scene("room?seed=1&lit=false").mesh
    gaussians = GaussianMap(len(mesh.vertices))
    block = np.zeros((ROWS, len(mesh.vertices)), np.float32)
    block[0:3], block[3], block[7:10] = mesh.vertices.T, 1.0, -5.0
    gaussians.append(block)
    gaussians.save_npz(tmp_path / "run" / "map.npz")
    assert main(["export", "run", "--out", "room.ply", "--up", up]) == 0
    assert which_way_is_up(read_map("room.ply").means, mesh.faces).up == up
