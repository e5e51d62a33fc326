"""What cannot be read is one sentence; help is whole, in any width, and says what is true."""

import os
import re

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.commands import COMMANDS
from activestructure_gym.evaluation.cli.parsing import parse


@pytest.mark.parametrize(
    "words, message",
    [
        ("compare --workers abc", "--workers: expected a whole number, got 'abc'"),
        ("compare --workers 1e3", "expected a whole number, got '1e3'"),
        ("compare --workers " + "9" * 5000, r"--workers: expected a whole number, got '9+\.\.\. \(5002 characters\)"),
        ("compare --workers " + "9" * 400, "--workers: expected a whole number"),
        ("compare --samples 9223372036854775808", "--samples: expected a whole number"),
        ("compare --timeout nan", "--timeout: expected a number, got 'nan'"),
        ("compare --timeout 1e400", "--timeout: expected a number"),
        ("compare --frmes 3", r"unrecognized options: --frmes, 3; did you mean --frames\?"),
        ("compare --policis b --sedes c", "did you mean --"),
        ("compare --out", "missing value for argument '--out'"),
        ("compare stray", "unrecognized options: stray"),
        ("compare --resume=3", "unrecognized options: 3"),
        ("compare --view-source ply", "invalid choice 'ply' for argument '--view-source'"),
        ("compare --nope " + "x" * 10_000, r"--nope, x+\.\.\. \(\d+ characters\)"),
        ("compare --tyro-print-completion zsh", "no option --tyro-print-completion"),
        ("compare --tyro_write_completion zsh file", "no option --tyro_write_completion"),
        ("compare --out=", "--out: expected a text, got ''"),
        ("export", "missing from asg export: RUN The directory of a finished run"),
        ("bench speed", "invalid choice 'speed'"),
        ("train --gamma high bc", "--gamma: expected a number, got 'high'"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(words, message, capsys):
    name = words.split()[0]
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1 and len(said.err) < 700
    assert re.match(f"asg: .*{message}", said.err), said.err
    assert said.err.endswith(f"asg {name} --help shows the options\n") or "completion" in said.err
    assert not re.search("[│╭]|invalid literal|could not convert|ValueError", said.err)


@pytest.mark.parametrize("word", ["a\0b", "caf\udce9"])
@pytest.mark.parametrize("option", [["--scenes"], ["--out"], ["--set"], []])
def test_bytes_that_are_no_text_are_refused(word, option):
    with pytest.raises(InputError, match="holds bytes that are no text"):
        parse(COMMANDS["compare"], "compare", [*option, word])


def test_newlines_and_markup_in_a_value_stay_in_the_sentence(capsys):
    assert main(["compare", "--workers", "[red]1\n2[/]\t│"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "[red]1" in said


@pytest.mark.parametrize("name", list(COMMANDS))
def test_help_is_whole(name, capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert main(["help", name]) == 0
    text = capsys.readouterr().out
    assert f"usage: asg {name}" in text
    assert "{None}" not in text and "(default: )" not in text and "None)" not in text and "docs/" not in text
    options = text[text.index("-h, --help") :].splitlines()
    if len(options) > 6:
        assert max(map(len, options)) > 80  # no terminal: wider than the 80 columns of a guess
    monkeypatch.setenv("COLUMNS", "70")
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert max(map(len, text[text.index("-h, --help") :].splitlines())) <= 70
    assert os.environ["COLUMNS"] == "70"


def test_help_of_an_unknown_command_names_the_nearest(capsys):
    assert main(["help", "compre"]) == 2
    assert "did you mean 'compare'" in capsys.readouterr().err


def test_the_working_directory_stands_last_on_the_path(tmp_path, monkeypatch, capsys):
    """A file called like a package must not be run in its place."""
    import sys

    (tmp_path / "tyro.py").write_text("raise SystemExit('run')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    assert main(["scenes", "--picture", "a.png"]) == 2
    assert sys.path[-1] == str(tmp_path)
