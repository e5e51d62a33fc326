"""A file that has no room ends a command with 1, and not with 2: nothing of what was given is wrong."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from activestructure_gym import files
from activestructure_gym.evaluation.archive import completion
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.report import summary
from tests.evaluation.written_runs import JOB, write_comparison


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_comparison(tmp_path_factory.mktemp("full") / "runs", [JOB])


@pytest.fixture(params=[errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def fails(request: pytest.FixtureRequest) -> Callable[..., Any]:
    def fail(*given: Any, **named: Any) -> Any:
        raise OSError(request.param, os.strerror(request.param))

    return fail


def test_a_map(runs: Path, fails: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(files, "open", fails, raising=False)
    run = next((runs / completion.JOBS).iterdir())
    assert main(["export", str(run), "--out", "x.ply"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("asg: 'x.ply' cannot be written: ") and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_report_says_that_the_runs_are_whole(
    runs: Path, fails: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr(summary, "runs_csv", fails)
    assert main(["report", str(runs), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert "out' cannot be written" in said and "The runs are complete" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_after_a_comparison_it_names_the_command_that_completes_it(
    runs: Path, fails: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    from activestructure_gym.evaluation.archive.comparison import open_comparison
    from activestructure_gym.evaluation.cli import closing, compare
    from activestructure_gym.evaluation.cli.output import make_console
    from activestructure_gym.evaluation.running.comparison import Result

    def finish(options: Any) -> int:
        return closing.print_end(make_console(), Result(open_comparison(runs), [], 0), runs, 1.0, None, wide=False)

    monkeypatch.setattr(summary, "runs_csv", fails)
    monkeypatch.setattr(compare.Compare, "run", finish)
    assert main(["compare"]) == 1
    assert f"`asg report {runs}` writes the report" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_for_another_reason_is_wrong_input(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*given: Any, **named: Any) -> Any:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(files, "open", denied, raising=False)
    assert main(["export", str(next((runs / completion.JOBS).iterdir())), "--out", str(tmp_path / "x.ply")]) == 2
