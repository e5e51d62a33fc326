import pytest

from activestructure_gym.evaluation.archive.store import COMPARISON
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.report import results as module
from activestructure_gym.evaluation.report import summary


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """What the report is asked for; nothing is read or drawn."""
    monkeypatch.chdir(tmp_path)
    calls = []

    class Nothing:
        runs, missing = (), {}

    def gather(directories, baseline, labels):
        assert labels == {}
        calls.append((directories, baseline))
        return Nothing()

    def write(out, results, published, more):
        assert not published and not more
        calls.append(out)
        return [out / "report.html"]

    monkeypatch.setattr(module, "gather", gather)
    monkeypatch.setattr(summary, "write_results", write)
    return calls, Nothing


def test_a_comparisons_report_stands_beside_it(asked, tmp_path, capsys):
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / COMPARISON).touch()
    assert main(["report", "c", "--baseline", "random"]) == 0
    (directories, baseline), out = asked[0]
    assert [str(one) for one in directories] == ["c"] and baseline == "random" and str(out) == "c"
    assert "c/report.html" in capsys.readouterr().out


def test_of_several_it_gets_a_place_of_its_own(asked):
    assert main(["report", "a", "b"]) == 0
    assert asked[0][1].parts[0] == "runs" and asked[0][1].name.startswith("report-")
    assert main(["report", "a", "b", "--out", "here"]) == 0
    assert str(asked[0][3]) == "here"


def test_missing_runs_are_named_and_end_with_one(asked, monkeypatch, capsys):
    monkeypatch.setattr(asked[1], "missing", {"room · a · seed 0": "RuntimeError: no"})
    assert main(["report", "a"]) == 1
    assert "room · a · seed 0" in capsys.readouterr().out


def test_wrong_input_is_one_sentence(tmp_path, capsys):
    assert main(["report", str(tmp_path / "nothing")]) == 2
    assert "has no finished run: it does not exist" in capsys.readouterr().err
    file = tmp_path / "file"
    file.touch()
    assert main(["report", str(tmp_path), "--out", str(file)]) == 2
    assert "is a file" in capsys.readouterr().err
