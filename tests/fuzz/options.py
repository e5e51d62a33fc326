"""Command lines: every command with right and hostile options; exit codes 0, 1, 2, and refusals of one line.

Work that was asked for in earnest is not done: the cases are about what is asked, and end where a run would begin.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext, redirect_stderr
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

CI_CASES = 60

_NUMBERS = (
    "-1", "0", "1", "2", "3.5", "1e3", "1e309", "-1e309", "nan", "inf", "-inf", "1e-320", "0x10", "1_0", "１２", "²",
    "2147483648", "4294967296", "9223372036854775807", "9223372036854775808", "9" * 400, "9" * 5000, "1000000000",
    "-0", "+1", "1,2", "true",
)  # fmt: skip
_TEXTS = (
    "", " ", "x", "a" * 300, "ä" * 200, "a/" * 3000, "x" * 100_000, "x\0y", "caf\udce9", "[red]x[/]", "[/]", "[", "..",
    "../" * 50, "/dev/zero", "/dev/null", "/proc/self/mem", "/", ".", "~", "~nobody_there", "-", "--", "-x", "a\nb",
    "a\rb", "a\x1b[31mb\x1b[0m", "%s{}%n", "$HOME", "None", "null", "?", "??", "&", "=", ",", ",,,", "a,b", "file.txt",
    "folder", "file.txt/below", "folder/new", "missing/folder/new", "\u202eevil", "\ud83d", "😀",
)  # fmt: skip
_SCENES = (
    "box", "room", "boxx", "box?", "box?size", "box?size=1,2", "box?size=1,2,x", "box?size=nan,1,1", "box?seed=-1",
    "box?size=1e308,1,1", "box?size=-1,-1,-1", f"box?seed={'9' * 5000}", "box?wrong=1", "apartment?rooms=99999999",
    "apartment?rooms=0", "apartment?seed=x", "mesh:", "mesh:missing.glb", "replica:", "replica:/", "matterport3d:.",
    "os:getcwd", "os:", ":os", "a:b", "a.b.c:d", f"{'a' * 300}:b", "json:loads?s=1", "file.txt", "file.txt?units=xx",
    "folder", "empty.glb", "empty.obj?units=m&up=q", "box?size=4,3,2.5&size=3,3,3", "box&size=3",
)  # fmt: skip
_POLICIES = (
    "random", "pixel_only", "all", "ladder", "randm", "random?x=1", "naruto?travel=far", "naruto?travel=", "naruto?",
    "learned:", "learned:file.txt", "learned:folder", "learned:/dev/zero", "learned:missing", "os:path", "os:getcwd",
    "builtins:dict", "a:b", ":", "random,random", "random,,", "activeinr?uncertainty=nan", "[red]",
    "random?" + "x=1&" * 2000,
)  # fmt: skip
_GAINS = ("pixel", "pixl", "os:path", "builtins:len", ":", "a:b", "", "pixel,pixel", "[/]", "pixel?x=1")
_VALUES = (
    "1", "0", "-1", "NaN", "Infinity", "-Infinity", "1e400", "1e308", "-1e308", "9" * 5000, "9223372036854775807",
    "0.5", "true", "null", "[]", "{}", "[1]", "[NaN]", '["x"]', '{"a": 1}', "[" * 100_000, '{"a":' * 5000, "text", '""',
    "", "[red]", "kinect", "a\nb", "caf\udce9", "[1, 2, 3]", '"\\ud800"', "1.5", "[[[]]]", "[0.0, 1e308]",
)  # fmt: skip
_PATHS = ("", ".", "..", "a", "a.b", ".a", "a.", "sensor", "sensor.", "sensor.x", "sensor.width.x", "frame_budget.x.y",
          "features", "features.0", "__class__", "sensor.__init__", "[red]", "x" * 10_000, "a\nb",
          "mapper.tracking")  # fmt: skip


class _Reached(Exception):
    """Everything was checked, and the work would begin."""


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A command line in a folder with a few files; the function runs it."""
    (folder / "file.txt").write_text("no scene, no run, no checkpoint\n")
    (folder / "empty.glb").touch()
    (folder / "empty.obj").touch()
    (folder / "folder").mkdir()
    arguments = _arguments(rng)
    environment = {}
    for name, values in _ENVIRONMENT.items():
        if rng.random() < 0.05:
            environment[name] = str(rng.choice(values))
    (folder / "arguments.json").write_text(json.dumps([arguments, environment]))
    return lambda: _run(arguments, environment, folder)


_ENVIRONMENT = {
    "COLUMNS": ["", "0", "-5", "x", "9" * 50, "1", "40"],
    "ASG_CACHE_MAX": ["much", "0", "-1", "1MB", "9" * 50],
    "ASG_LPIPS_WEIGHTS": ["", "file.txt", "missing", "folder", "/dev/zero"],
    "OMP_NUM_THREADS": ["", "x", "-1", "1"],
}


def _arguments(rng: np.random.Generator) -> list[str]:
    from activestructure_gym.evaluation.cli.commands import COMMANDS, find_command, parts_of

    if rng.random() < 0.08:
        first = _pick(rng, ("", "help", "--help", "-h", "--version", "compre", "[red]", "-x", "a\nb", "x" * 1000, "--"))
        return [first, *_some(rng, (*COMMANDS, *_TEXTS), 2)]
    name = _pick(rng, (*COMMANDS, "compare", "compare", "compare", "train", "train", "evaluate"))
    kind = find_command(name)
    parts = parts_of(kind)
    part = _pick(rng, tuple(parts)) if parts else ""
    fields = dataclasses.fields(parts.get(part, kind))
    words = [name]
    for field in [fields[k] for k in rng.permutation(len(fields))[: rng.integers(0, 4)]]:
        values = _values(rng, field.name)
        positional = "Positional" in str(field.type) or field.type == "Runs"
        option = f"--{field.name.replace('_', '-')}"
        if positional:
            words[1:1] = values
        elif rng.random() < 0.1:
            words.append(f"{option}={values[0] if values else ''}")
        else:
            words += [option, *values]
    if parts and rng.random() < 0.8:  # now and then another part than the one the options are of
        words.insert(1, part if rng.random() < 0.8 else _pick(rng, tuple(parts)))
    if rng.random() < 0.05:
        words.insert(int(rng.integers(1, len(words) + 1)), _pick(rng, _TEXTS))
    return words


def _values(rng: np.random.Generator, name: str) -> list[str]:
    if name in ("resume", "quick", "json", "noise", "trust_code", "dry_run", "exit"):
        return _some(rng, ("true", "x"), 1) if rng.random() < 0.1 else []
    if name == "set":
        return [_override(rng) for _ in range(rng.integers(0, 4))]
    if rng.random() < 0.15:
        return _some(rng, _TEXTS, 2)
    if name in ("scenes", "scene", "spec"):
        return _some(rng, _SCENES, 2)
    if name in ("policies", "names", "baseline", "baselines"):
        return _some(rng, _POLICIES, 2)
    if name in ("features", "teacher"):
        return _some(rng, _GAINS, 2)
    if name in ("seeds", "rooms"):
        return _some(rng, _NUMBERS, 3)
    if name == "start":
        return [",".join(_some(rng, _NUMBERS, 5))]
    if name == "preset":
        return _some(rng, ("fast", "default", "full", "paper", "fats", "", "[red]"), 1)
    if name in ("out", "data", "map", "poses", "lpips_weights", "picture", "runs", "run_directory"):
        return _some(rng, _TEXTS, 1)
    if name in ("engine", "protocols", "setup", "format", "what", "shell", "part", "reward", "view_source", "up"):
        return _some(rng, ("local", "standard", "activegamer", "ply", "z", "env", "bash", "all", "x", "", "[/]"), 1)
    return _some(rng, _NUMBERS, 1)


def _override(rng: np.random.Generator) -> str:
    from activestructure_gym.config import ReconstructionConfig
    from activestructure_gym.evaluation.cli.config import leaves

    paths = [path for path, _ in leaves(ReconstructionConfig())]
    path = _pick(rng, paths) if rng.random() < 0.75 else _pick(rng, _PATHS)
    return f"{path}={_pick(rng, _VALUES)}" if rng.random() < 0.95 else _pick(rng, _TEXTS)


def _pick(rng: np.random.Generator, values: Sequence[str]) -> str:
    return values[int(rng.integers(len(values)))]


def _some(rng: np.random.Generator, values: Sequence[str], most: int) -> list[str]:
    return [_pick(rng, values) for _ in range(rng.integers(1, most + 1))]


def _run(arguments: list[str], environment: dict[str, str], folder: Path) -> None:
    """Raises what the harness counts: nothing, `InputError`, or the exit code."""
    from activestructure_gym.errors import InputError
    from activestructure_gym.evaluation.cli import main

    os.chdir(folder)
    said = io.StringIO()
    with ExitStack() as stack:
        stack.enter_context(mock.patch.dict(os.environ, environment))
        for place in _WORK:
            stack.enter_context(mock.patch(place, _reach))
        stack.enter_context(mock.patch(f"{_PACKAGE}.evaluation.running.comparison.warming_up", _nothing))
        stack.enter_context(mock.patch(f"{_PACKAGE}.evaluation.protocols.StandardProtocol.truth", lambda *_: None))
        stack.enter_context(redirect_stderr(said))
        try:
            code = main(arguments)
        except _Reached:
            return
    text = said.getvalue()
    if code != 2:
        if "Traceback" in text or code not in (0, 1):
            raise AssertionError(f"exit code {code}: {text[-300:]}")
        return
    if text.startswith("╭─ "):  # a message of tyro
        raise InputError("tyro refuses the words")
    if not text.startswith("asg: "):
        raise AssertionError(f"refused without a sentence: {text[:300]!r}")
    raise InputError(text.removesuffix("\n"))


def _nothing(*_: Any, **__: Any) -> AbstractContextManager[None]:
    return nullcontext()


def _reach(*_: Any, **__: Any) -> Any:
    raise _Reached


_PACKAGE = "activestructure_gym"
_WORK = (
    f"{_PACKAGE}.evaluation.running.comparison.run_comparison",
    f"{_PACKAGE}.evaluation.cli.train.learning._run",
    f"{_PACKAGE}.evaluation.training.scoring.play_cells",
    f"{_PACKAGE}.evaluation.cli.bench.Bench.run",
    f"{_PACKAGE}.evaluation.cli.scenes.describe",
    f"{_PACKAGE}.evaluation.cli.doctor.Doctor.run",
    f"{_PACKAGE}.evaluation.reproduction.remeasure.measure_file",
    f"{_PACKAGE}.evaluation.cli.cache._clear",
    f"{_PACKAGE}.evaluation.cli.watch.play",
)
