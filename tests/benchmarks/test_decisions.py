import json

import pytest

from activestructure_gym.evaluation.archive.directory_lock import hold
from benchmarks import frozen_decisions as benchmark
from benchmarks.command import run
from benchmarks.decisions import Decisions


def made_up(scene, seed, settings, notify):
    notify(settings.frames)
    picks = {"feature pixel": {"row": 0, "rate": 0.5}}
    table = {"views": 3, "best": 1.0, "mean": 0.25}
    return [{"scene": scene, "seed": seed, "decision": 0, "frames": 1, "table": table, "pool": table, "picks": picks}]


def test_finished_episodes_are_kept_and_other_settings_refused(monkeypatch, capsys, tmp_path):
    played = []
    monkeypatch.setattr(benchmark, "frozen_decisions", lambda *given: played.append(given[:2]) or made_up(*given))
    command = ["--features", "pixel", "--out", str(tmp_path / "new"), "--seeds"]
    assert run(Decisions, [*command, "0", "--scenes", "box"]) == 0
    assert run(Decisions, [*command, "0,1", "--scenes", "box,room"]) == 0
    assert played == [("box", 0), ("box", 1), ("room", 0), ("room", 1)]
    assert "feature pixel" in capsys.readouterr().out
    written = json.loads((tmp_path / "new" / "decisions.json").read_text())
    assert len(written["decisions"]) == 4 and written["rows"][1]["of_the_table's_best"] == 0.5
    records = tmp_path / "new" / "decisions.jsonl"
    assert len(records.read_text().splitlines()) == 4 and not list(records.parent.glob(".*.tmp"))
    with hold(records.parent):  # somebody else is at it
        assert run(Decisions, [*command, "2"]) == 2
    assert len(played) == 4 and "new" in capsys.readouterr().err
    assert run(Decisions, [*command, "0", "--frames", "20"]) == 2
    assert "begun with other settings" in capsys.readouterr().err
    (tmp_path / "new" / "settings.json").write_text("{")
    assert run(Decisions, [*command, "0"]) == 2
    assert "damaged" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--every 0", "--every must be at least 1, got 0"),
        ("--preset full --frames 0", "--frames must be at least 1, got 0"),
        ("--preset fulll", "unknown preset 'fulll'"),
        ("--quality -1", "--quality must be at least 0"),
        ("--pool 0", "--pool at least 1"),
        ("--seeds=-1", "a seed is a whole number"),
        ("--policies nobody", "unknown policy 'nobody'"),
        ("--policies reference:oracle", "'reference:oracle' is not a policy: ask for it by --references oracle"),
        ("--played reference:oracle", "'reference:oracle' is not a policy"),
        ("--played hole_area,random", "--played is one policy, got 2"),
        ("--played nobody", "unknown policy 'nobody'"),
        ("--features nothing", "unknown feature 'nothing'"),
        ("--scenes nothing", "unknown scene 'nothing'"),
        ("--out {file}", "--out is a directory for results, and"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(capsys, tmp_path, words, said):
    (tmp_path / "file").write_text("")
    scene = [] if "--scenes" in words else ["--scenes", "box"]
    given = words.format(file=tmp_path / "file").split()
    out = [] if "--out" in words else ["--out", str(tmp_path / "out")]
    assert run(Decisions, [*scene, *given, *out]) == 2
    error = capsys.readouterr().err
    assert "--scenes" in words or not (tmp_path / "out").exists()
    assert said in error and error.startswith("asg: ") and error.count("\n") == 1
