"""What cannot be read is one sentence; help is whole, in any width, and says what is true."""

import os
import re

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
        ("bench speed", "unknown part 'speed'"),
        ("bench spltting", "unknown part 'spltting'; did you mean 'splatting'"),
        ("bench", "expected one of {sensor, splatting"),
        ("bench sensor --quick", "unrecognized options: --quick; --quick is an option of decisions, env, evaluation"),
        ("bench growth --preset fast", "--preset is an option of decisions, env; asg bench growth"),
        ("train ppo --gamma high", "--gamma: expected a number, got 'high'"),
        ("train ppo --data elsewhere", "--data, elsewhere; --data is an option of bc, rank; asg train ppo"),
        ("train bc --start runs/a", "--start is an option of ppo;"),
        ("train rank --temperature 2", "--temperature is an option of bc;"),
        ("train score --gains pixel", "--gains is an option of bc, ppo, rank;"),
        ("train rank --temprature 2", r"did you mean --temperature of bc\?"),
        ("train bc --temprature 2", r"did you mean --temperature\?"),
        ("train --seed 3 bc", "--seed is an option of bc, ppo, rank and stands behind that name"),
        ("train bc --tyro-print-completion zsh", "unrecognized options: --tyro-print-completion"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(words, message, capsys):
    name = words.split()[0]
    assert main(words.split()) == 2
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1 and len(said.err) < 700
    assert re.match(f"asg: .*{message}", said.err), said.err
    part = next((f" {word}" for word in words.split()[1:2] if word in parts_of(find_command(name))), "")
    assert said.err.endswith(f"asg {name}{part} --help shows the options\n") or "completion" in said.err
    assert not re.search("[│╭]|invalid literal|could not convert|ValueError", said.err)


@pytest.mark.parametrize("word", ["a\0b", "caf\udce9"])
@pytest.mark.parametrize("option", [["--scenes"], ["--out"], ["--set"], []])
def test_bytes_that_are_no_text_are_refused(word, option):
    with pytest.raises(InputError, match="holds bytes that are no text"):
        parse(find_command("compare"), "compare", [*option, word])


def test_newlines_and_markup_in_a_value_stay_in_the_sentence(capsys):
    assert main(["compare", "--workers", "[red]1\n2[/]\t│"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "[red]1" in said


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
    assert max(map(len, text[text.index("-h, --help") :].splitlines())) <= 70
    assert os.environ["COLUMNS"] == "70"


def test_an_empty_word_is_no_part(capsys):
    assert main(["train", ""]) == 2
    assert capsys.readouterr().err.startswith("asg: unknown part ''. Known: bc, ppo, rank, score;")


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
        list(train) == ["bc", "rank", "ppo", "score"] and "splatting" in bench and not parts_of(find_command("scenes"))
    )
    taken = {name: {field.name for field in dataclasses.fields(kind)} for name, kind in (train | bench).items()}
    assert taken["bc"] - taken["rank"] == {"temperature"} and not taken["rank"] - taken["bc"]
    assert taken["ppo"] - taken["bc"] == {"start", "iterations", "steps", "envs"}
    assert not taken["score"] & {"seed", "gains", "noise", "resume", "gamma"}
    assert taken["splatting"] == {"workloads", "repeats", "baseline"} and taken["sensor"] == {"scene"}


def test_a_list_that_is_said_twice_has_all_its_values():
    words = "--set a=1 --frames 5 --set b=2 --scenes room,box --set=c=3 d=4 --scenes apartment --frames 6"
    options = parse(find_command("compare"), "compare", words.split())
    assert options.set == ("a=1", "b=2", "c=3", "d=4")
    assert options.scenes == ("room,box", "apartment") and options.frames == 6  # of a single value the last one
    assert gathered("runs/a --out x runs/b --out y".split(), ["--set"]) == "runs/a --out x runs/b --out y".split()
    assert gathered("runs/a --set_it b --set-it c".split(), ["--set-it"]) == "runs/a --set_it b c".split()


def test_so_has_one_of_a_part():
    words = "decisions --policies hole_area --policies random,pixel_only".split()
    assert parse(find_command("bench"), "bench", words).part.policies == ("hole_area", "random,pixel_only")
