"""Messages and help are whole, in any width and encoding, and say what is true."""

import io
import os
import re
import shlex

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.commands import COMMANDS, find_command, parts_of
from activestructure_gym.evaluation.cli.parsing import gathered, parse


@pytest.mark.parametrize(
    "words, message",
    [
        ("compare --workers abc", "--workers: expected a whole number, got 'abc'"),
        ("compare --workers 1e3", "expected a whole number, got '1e3'"),
        ("compare --workers " + "9" * 5000, r"--workers: expected a whole number, got '9+\.\.\.'"),
        ("compare --samples 9223372036854775808", "--samples: expected a whole number"),
        ("compare --timeout-min nan", "--timeout-min: expected a number, got 'nan'"),
        ("compare --timeout-min 1e400", "--timeout-min: expected a number"),
        ("compare --frmes 3", "Unrecognized options: --frmes, 3 .*Perhaps you meant: --frames N"),
        ("compare --out", "Missing value for argument '-o/--out'"),
        ("compare stray", "Unrecognized options: stray"),
        ("compare --view-source ply", "invalid choice 'ply' for argument '--view-source'"),
        ("compare --nope " + "x" * 10_000, r"--nope, x{160}\.\.\."),
        ("compare --out=", "--out: expected a text, got ''"),
        ("export", "Missing from asg export: RUN"),
        ("bench spltting", "Unrecognized options: spltting .*Available subcommands: .*splatting"),
        ("bench", "Expected one of {.*splatting"),
        ("train", "Expected one of {bc, rank, ppo, eval}"),
        ("train ''", "bc, rank, ppo, eval"),
        ("list", "Expected one of {policies, scenes, worlds, features, config}"),
        ("train rank --temperature 2", "--temperature X .*in asg train bc --help"),
        ("train --seed 3 bc", "--seed N .*in asg train bc --help"),
    ],
)
def test_a_message_of_tyro_says_what_is_wrong_and_fits(words, message, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(shlex.split(words)) == 2
    said = capsys.readouterr()
    lines = said.err.splitlines()
    assert not said.out and len(lines) < 40 and max(map(len, lines)) <= 80
    text = " ".join(said.err.translate(dict.fromkeys(map(ord, "│╭╮╰╯─"))).split())
    text = text if "xxx" not in words and "999" not in words else text.replace("x x", "xx").replace("9 9", "99")
    assert re.search(message, text), said.err
    assert f"asg {words.split()[0]}" in text and "--help" in text
    assert not re.search("invalid literal|could not convert|Traceback", said.err)


@pytest.mark.parametrize("option", ["--tyro-print-completion", "--tyro_write_completion"])
def test_completion_has_one_door(option, capsys):
    assert main(["compare", option, "zsh", "file"]) == 2
    assert capsys.readouterr().err.startswith(f"asg: compare has no option '{option}'; `asg completion`")


@pytest.mark.parametrize("word", ["a\0b", "caf\udce9"])
@pytest.mark.parametrize("option", [["--scenes"], ["--out"], ["--set"], []])
def test_bytes_that_are_no_text_are_refused(word, option):
    with pytest.raises(InputError, match="holds bytes that are not text"):
        parse(find_command("compare"), "compare", [*option, word])


def test_a_word_in_a_message_is_printable_text_on_its_line(capsys):
    assert main(["compare", "--workers", "[red]1\n2[/]\t│", "--nope", "\x1b[31m\n✓ forged"]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said and "\\x1b[31m ✓ forged" in said and all(line[0] in "╭│╰" for line in said.splitlines())


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437"])
def test_a_message_fits_the_encoding(encoding, monkeypatch):
    below = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr("sys.stderr", below)
    assert main(["compare", "--frmes", "✓"]) == 2
    below.seek(0)
    assert "Unrecognized options: --frmes, " in below.read()


EVERY = [
    name for command in COMMANDS for name in (command, *(f"{command} {p}" for p in parts_of(find_command(command))))
]


@pytest.mark.parametrize("name", EVERY)
def test_help_is_whole(name, capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert main(["help", *name.split()]) == 0
    text = capsys.readouterr().out
    assert f"usage: asg {name}" in text
    assert "{None}" not in text and "(default: )" not in text and "None)" not in text and "docs/" not in text
    options = text[text.index("-h, --help") :].splitlines()
    if len(options) > 6:
        assert max(map(len, options)) > 80  # no terminal: wider than the 80 columns of a guess
    monkeypatch.setenv("COLUMNS", "70")
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 70
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


def test_a_part_has_its_own_options_alone():
    import dataclasses

    train, bench = (parts_of(find_command(name)) for name in ("train", "bench"))
    assert (
        list(train) == ["bc", "rank", "ppo", "eval"] and "splatting" in bench and not parts_of(find_command("scenes"))
    )
    taken = {name: {field.name for field in dataclasses.fields(kind)} for name, kind in (train | bench).items()}
    assert taken["bc"] - taken["rank"] == {"temperature"} and not taken["rank"] - taken["bc"]
    assert taken["ppo"] - taken["bc"] == {"start", "iterations", "steps", "envs"}
    assert not taken["eval"] & {"seed", "features", "noise", "resume", "gamma"}
    assert taken["splatting"] == {"workloads", "repeats", "baseline"} and taken["sensor"] == {"scenes"}


def test_a_list_that_is_said_twice_has_all_its_values():
    words = "--set a=1 --frames 5 --set b=2 --scenes room,box --set=c=3 d=4 --scenes apartment --frames 6"
    options = parse(find_command("compare"), "compare", words.split())
    assert options.set == ("a=1", "b=2", "c=3", "d=4")
    assert options.scenes == ("room,box", "apartment") and options.frames == 6  # of a single value the last one
    assert gathered("runs/a --out x runs/b --out y".split(), ["--set"]) == "runs/a --out x runs/b --out y".split()
    assert gathered("runs/a --set_it b -o d --set-it c".split(), ["--set-it"]) == "runs/a --set-it b c -o d".split()


@pytest.mark.parametrize(
    "words", [["--sweep"], ["--sweep", "--views", "4"], ["--sweep", "-n"], ["--sweep", ""], ["--sweep="]]
)
def test_a_list_without_a_value_is_refused(words):
    with pytest.raises(InputError, match="compare: --sweep lacks a value"):
        parse(find_command("compare"), "compare", words)


def test_so_has_one_of_a_part():
    words = "splatting --workloads W1 --workloads W2,W4".split()
    assert parse(find_command("bench"), "bench", words).part.workloads == ("W1", "W2,W4")
