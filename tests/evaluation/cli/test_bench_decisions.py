import json

from activestructure_gym.evaluation.benchmarks import decisions as benchmark
from activestructure_gym.evaluation.cli import main


def made_up(scene, seed, settings, tell):
    tell(settings.frames)
    picks = {"feature pixel": {"row": 0, "rate": 0.5}}
    table = {"views": 3, "best": 1.0, "mean": 0.25}
    return [{"scene": scene, "seed": seed, "decision": 0, "frames": 1, "table": table, "pool": table, "picks": picks}]


def test_finished_episodes_are_kept_and_other_settings_refused(monkeypatch, capsys, tmp_path):
    played = []
    monkeypatch.setattr(benchmark, "frozen_decisions", lambda *given: played.append(given[:2]) or made_up(*given))
    command = ["bench", "decisions", "--features", "pixel", "--out", str(tmp_path / "new"), "--seeds"]
    assert main([*command, "0", "--scene", "box"]) == 0
    assert main([*command, "0,1", "--scene", "box,room"]) == 0
    assert played == [("box", 0), ("box", 1), ("room", 0), ("room", 1)]
    assert "feature pixel" in capsys.readouterr().out
    written = json.loads((tmp_path / "new" / "decisions.json").read_text())
    assert len(written["decisions"]) == 4 and written["rows"][1]["of_the_table's_best"] == 0.5
    assert main([*command, "0", "--frames", "20"]) == 2
    assert "begun with other settings" in capsys.readouterr().err
    (tmp_path / "new" / "settings.json").write_text("{")
    assert main([*command, "0"]) == 2
    assert "damaged" in capsys.readouterr().err


def test_numbers_that_cannot_be_are_refused(capsys):
    assert main(["bench", "decisions", "--every", "0"]) == 2
    assert "--every must be at least 1" in capsys.readouterr().err
