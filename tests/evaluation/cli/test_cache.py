"""The command `asg cache` shows and removes what is kept, and nothing else."""

import json

import numpy as np
import pytest

from activestructure_gym.compiling import files
from activestructure_gym.evaluation.cli import main
from activestructure_gym.scenes.cache import cached_arrays


@pytest.fixture(autouse=True)
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv("ASG_CACHE_DIR", str(tmp_path / "scenes"))
    monkeypatch.setenv("ASG_CACHE_MAX", "3MB")
    for key in "ab":
        cached_arrays(key, lambda: {"a": np.zeros(100_000, np.uint8)})
    (tmp_path / "scenes" / "thesis.tex").touch()
    (tmp_path / "one.kernel").write_bytes(bytes(5000))
    monkeypatch.setattr(files, "kernel_files", lambda: list(tmp_path.glob("*.kernel")))
    return tmp_path


def test_it_shows_what_is_kept_and_where(kept, capsys):
    assert main(["cache"]) == 0
    out = capsys.readouterr().out
    assert "0.2 MB" in out and "3.1 MB" in out and str(kept / "scenes") in out and "kernels" in out
    assert main(["cache", "show", "scenes", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row == {
        "part": "scenes", "files": 2, "bytes": row["bytes"], "limit": 3 << 20, "place": str(kept / "scenes")
    }  # fmt: skip


@pytest.mark.parametrize(
    "part, left",
    [("scenes", ["one.kernel", "thesis.tex"]), ("kernels", ["a", "b", "thesis.tex"]), ("", ["thesis.tex"])],
)
def test_it_removes_what_is_asked_for(part, left, kept, capsys):
    assert main(["cache", "clear", *filter(None, [part])]) == 0
    files = sorted(file.name.partition("-v")[0] for file in kept.rglob("*") if file.is_file())
    assert files == left
    assert "files removed" in capsys.readouterr().out


def test_a_size_that_is_none_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setenv("ASG_CACHE_MAX", "[red]")
    assert main(["cache"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("asg: ASG_CACHE_MAX is a size such as 500MB") and said.count("\n") == 1
