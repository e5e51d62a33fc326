"""A run as a video: it plays, its pictures differ, and nothing is left where it cannot be."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.replay import video


@pytest.mark.parametrize("ending", [pytest.param("mp4", marks=pytest.mark.slow), "webm"])
def test_a_video_has_a_picture_for_every_keyframe(
    finished: list[Run],
    tmp_path: Path,
    ending: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run, path = finished[0], tmp_path / f"run.{ending}"
    last = 20
    if ending == "webm":  # VP9 is slow to write
        last = 2
        monkeypatch.setattr(video, "_LAST_REPEATS", last)
    assert main(["replay", str(run.directory), "--video", str(path)]) == 0
    keyframes = len(run.trajectory["keyframes"])
    assert f"run.{ending}: {(keyframes + last) / 10:.0f} s" in capsys.readouterr().out
    film, pictures = cv2.VideoCapture(str(path)), []
    while (read := film.read())[0]:
        pictures.append(read[1].astype(int))
    assert len(pictures) == keyframes + last  # the end is shown for two seconds
    assert np.abs(pictures[0] - pictures[keyframes]).mean() > 2
    assert np.abs(pictures[-1] - pictures[-2]).mean() < 1
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_what_cannot_be_a_video_is_said(
    finished: list[Run], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = (str(run.directory) for run in finished)
    for words, message in (
        ([one, "--video", str(tmp_path / "run.gif")], "a video ends in .mp4 or .webm, got 'run.gif'"),
        ([one, other, "--video", str(tmp_path / "run.mp4")], "shows one run"),
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
    monkeypatch.setattr(video, "_LAST_REPEATS", 1)
    monkeypatch.setattr(video, "is_complete", lambda path, images: False)
    assert main(["replay", str(finished[0].directory), "--video", str(tmp_path / "run.mp4")]) == 1
    assert "cannot be written whole" in capsys.readouterr().err and not list(tmp_path.iterdir())
