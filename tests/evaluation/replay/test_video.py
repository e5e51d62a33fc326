"""The film of a run or two: maps, names and curves, six seconds, and nothing is left where it cannot be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.replay import Recording, film, video


@pytest.fixture(scope="module")
def images(recordings: list[Recording]) -> list[np.ndarray]:
    """The film of both runs, in which every image is drawn once."""
    return list(film.film_images(recordings))


def test_a_film_shows_two_growing_maps_with_their_names_and_a_curve_each(
    images: list[np.ndarray], recordings: list[Recording]
) -> None:
    assert len(images) == round(film.PLAYED_S * film.IMAGES_PER_SECOND)
    assert {image.shape for image in images} == {(686, 1200, 3)}
    for number, tint in enumerate([(0, 114, 178), (213, 94, 0)]):
        column = [image[:, 600 * number : 600 * (number + 1)] for image in images]
        name, first, last, curve = column[0][:66], column[0][66:496], column[-1][66:496], column[-1][496:]
        for part in (name, curve):
            assert (np.abs(part.astype(int) - tint).sum(axis=2) < 12).sum() > 500
        rows = np.nonzero((np.abs(name.astype(int) - tint).sum(axis=2) < 12).any(axis=1))[0]
        assert rows[-1] - rows[0] > 25  # a tenth of a phone's width if the film is as wide as the phone
        drawn = [(part < 250).any(axis=2).mean() for part in (first, last)]
        assert 0.02 < drawn[0] < drawn[1] and last.std() > 10
        assert (np.abs(last.astype(int) - film.PATH).sum(axis=2) < 12).sum() > 200
    assert all((one != other).any() for one, other in zip(images[::9], images[9::9]))


def test_a_run_without_a_curve_is_shown_without_one(recordings: list[Recording]) -> None:
    run = replace(recordings[0].run)
    run.__dict__["metrics"] = run.metrics | {"curve": [{"frames": 1}]}
    image = next(film.film_images([replace(recordings[0], run=run)]))
    assert image.shape == (film.NAME_HEIGHT + film.MAP_HEIGHT, film.WIDTH, 3)


@pytest.mark.parametrize("unit, value", [("%", 100.0), ("m³", 50.0), ("m³", 2050.0)])
def test_the_value_of_a_curve_does_not_cover_the_curve(unit: str, value: float) -> None:
    """The curve ends at the top of its axis, so the rows of its value have only its left part."""
    curve = film._Curve("known space", unit, np.array([1.0, 150.0]), np.array([0.0, value]))
    shown = np.asarray(film._chart(curve, [curve], 150, 150, (213, 94, 0))).astype(int)
    tinted = np.abs(shown - (213, 94, 0)).sum(axis=2) < 12
    end = np.nonzero(tinted[:72].any(axis=0))[0][-1]  # of the dot
    text = np.nonzero(tinted[88:118, end - 40 :].any(axis=0))[0] + end - 40
    assert text[0] - end >= 10 and text[-1] < film.WIDTH


def test_the_pose_at_a_frame_is_that_of_the_run(recordings: list[Recording]) -> None:
    for recording in recordings:
        numbers = [film.pose_number(recording, frame) for frame in range(1, 41)]
        assert numbers == list(range(40))  # a pose per frame


def test_the_map_is_seen_from_outside_and_whole() -> None:
    bounds = np.array([[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]])
    camera = film.PinholeCamera(600, 430, 473.0, 473.0, 300.0, 215.0)
    pose = film.outside_pose(bounds, np.array([3.0, 0.5, 1.0]), 600 / 430)
    assert pose[0, 3] > 4.0 and pose[1, 3] < 0.0  # from the side of the start
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) > 0
    corners = np.array([[x, y, z] for x in (0.0, 4.0) for y in (0.0, 3.0) for z in (0.0, 2.1)])
    u, v = camera.project((corners - pose[:3, 3]) @ pose[:3, :3]).T
    assert u.min() > 0 and u.max() < 600 and v.min() > 0 and v.max() < 430
    assert v[::2].mean() > v[1::2].mean()  # the floor is below


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["mp4", "webp", "webm"])
def test_a_film_has_six_seconds_and_less_than_three_megabytes(
    images: list[np.ndarray], recordings: list[Recording], tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "film_images", lambda recordings: iter(images))
    path = tmp_path / f"film.{ending}"
    assert video.write_video(recordings, path) == 6.0
    assert path.stat().st_size < 3e6 and [file.name for file in tmp_path.iterdir()] == [path.name]
    if ending == "webp":
        shown, times = Image.open(path), []
        for number in range(shown.n_frames):  # type: ignore[attr-defined]
            shown.seek(number)
            times.append(np.asarray(shown.convert("RGB")).std() > 10 and shown.info["duration"])
        assert all(times) and sum(times) == pytest.approx(6000, abs=50) and shown.size == (1200, 686)
        return
    pictures, opened = [], cv2.VideoCapture(str(path))
    while (read := opened.read())[0]:
        pictures.append(read[1].astype(int))
    assert len(pictures) == 72 and opened.get(cv2.CAP_PROP_FPS) == 12
    assert min(picture.std() for picture in pictures) > 10
    assert np.abs(pictures[0] - pictures[53]).mean() > 2 and np.abs(pictures[-1] - pictures[-2]).mean() < 1


def test_the_command_writes_a_film(
    finished: list[Run], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "PLAYED_S", 0.5)
    assert main(["replay", *(str(run.directory) for run in finished), "--video", str(tmp_path / "run.mp4")]) == 0
    assert "run.mp4: " in capsys.readouterr().out and (tmp_path / "run.mp4").stat().st_size > 10_000


def test_what_cannot_be_a_video_is_said(
    finished: list[Run], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = str(finished[0].directory)
    for words, message in (
        ([one, "--video", str(tmp_path / "run.gif")], "a video ends in .mp4, .webm or .webp, got 'run.gif'"),
        ([one, "--video", str(tmp_path / "run.mp4"), "--out", "page.html"], "takes the place of --out"),
        ([one, "--video", str(tmp_path / "nowhere" / "run.mp4")], "in a directory that exists"),
    ):
        assert main(["replay", *words]) == 2
        assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending, codec", [("mp4", "mp4v"), ("webm", "VP80")])
def test_a_video_that_was_cut_off_is_found(tmp_path: Path, ending: str, codec: str) -> None:
    path, rng = tmp_path / f"film.{ending}", np.random.default_rng(0)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10, (64, 48))
    for _ in range(30):
        writer.write(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    writer.release()
    assert video.is_complete(path, 30) and not video.is_complete(path, 60)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert not video.is_complete(path, 30)


def test_a_video_without_room_takes_no_name(
    finished: list[Run], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "PLAYED_S", 0.2)
    monkeypatch.setattr(video, "is_complete", lambda path, images: False)
    assert main(["replay", str(finished[0].directory), "--video", str(tmp_path / "run.mp4")]) == 1
    assert "cannot be written whole" in capsys.readouterr().err and not list(tmp_path.iterdir())
