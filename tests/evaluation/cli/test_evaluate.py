"""Measuring again: what cannot be kept is measured all the same, and what is left out is said."""

from __future__ import annotations

import errno

import pytest

from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.completion import DONE, JOBS
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import COMPARISON
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.protocols import get_protocol
from activestructure_gym.evaluation.reproduction import remeasure
from tests.evaluation.written_runs import write_comparison

GRID = [Job("room", "random", seed, scene_hash="ab" * 32) for seed in range(2)]


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Two runs whose maps nobody has to measure."""
    place = write_comparison(tmp_path / "all", GRID)
    new = [(get_protocol("standard"), None)]
    monkeypatch.setattr(remeasure, "protocols_of", lambda run, names: new)
    monkeypatch.setattr(remeasure, "measure_again", lambda run, protocol: run.metrics["metrics"])
    return place


def test_numbers_are_printed_where_they_cannot_be_kept(measured, monkeypatch, capsys):
    def read_only(path, content):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(store, "write_json", read_only)
    assert main(["evaluate", str(measured)]) == 1
    told = "".join(capsys.readouterr().out.split())
    assert "identical" not in told  # nothing was stored that it could be compared with
    assert "80" in told and told.count("standard.json'cannotbewritten:Read-onlyfilesystem") == 2


def test_numbers_are_headed_as_in_reports_without_what_nobody_has(measured, capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert main(["evaluate", str(measured)]) == 0
    head = next(line for line in capsys.readouterr().out.splitlines() if "protocol" in line)
    assert "C.R. (%)" in head and "PSNR (dB)" in head and "LPIPS" not in head and "completion_ratio" not in head
    assert head.index("same") < head.index("C.R.")


def test_runs_that_are_left_out_are_said(measured, capsys):
    assert main(["evaluate", str(measured)]) == 0
    assert capsys.readouterr().err == ""
    (measured / JOBS / GRID[1].name / DONE).unlink()
    assert main(["evaluate", str(measured)]) == 0
    assert "1 of 2 runs in" in capsys.readouterr().err


_METRICS = f"{JOBS}/{GRID[0].name}/metrics.json"


@pytest.mark.parametrize(
    "command, name",
    [("evaluate {}", COMPARISON), ("evaluate {}", _METRICS), ("report {}", COMPARISON),
     ("report {} --out report", COMPARISON)],
)  # fmt: skip
def test_damage_ends_with_two_and_leaves_nothing(measured, name, command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (measured / name).write_bytes(b"\xff")
    before = sorted(tmp_path.rglob("*"))
    assert main(command.format("all").split()) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and f"all/{name}' is damaged" in said[0]
    assert sorted(tmp_path.rglob("*")) == before


def test_a_report_leaves_a_damaged_run_out_and_names_it(measured, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (measured / _METRICS).write_bytes(b"\xff")
    assert main(["report", "all", "--out", "report"]) == 1
    assert f"all/{_METRICS}' is damaged" in capsys.readouterr().out
    summary = (tmp_path / "report" / "summary.md").read_text()
    assert "Not finished, not counted (1):" in summary and "is damaged" in summary


@pytest.mark.parametrize(
    "command, place",
    [("scenes box --picture /proc/x.png", "/proc/x.png"),
     ("evaluate --map a.ply --scene box --out nowhere/x.json", "nowhere/x.json")],
)  # fmt: skip
def test_a_place_that_cannot_be_written_is_one_sentence(command, place, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(command.split()) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and f"'{place}' cannot be written" in said[0]
