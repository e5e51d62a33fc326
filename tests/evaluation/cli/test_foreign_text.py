"""Text of others never drives a terminal: whatever stands in a file that a command reads, it is printed as text."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.archive import completion, store
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import main
from activestructure_gym.policies.random import Random
from tests.evaluation.written_runs import write_comparison

BAD = "\x1b]0;T\x07\x1b[8m\x1b[2J\x9b5m\r\x00\x7f\u202ecba\u2066\u200f\n✓ forged"
OWN = re.compile(  # of rich itself: colours, the cursor, a line that is drawn again, a link
    r"\x1b\[[0-9;]*m|\x1b\[\?25[lh]|\x1b\[2K|\x1b\[\d?A|\x1b\]8;[!-~]*\x1b\\|\r(?=\x1b\[2K|\x1b\[1A|\n|$)"
)


def harmless(said: str) -> bool:
    """Whether nothing but text and line ends is left without what rich draws with; and no line of another's making."""
    left = OWN.sub("", said)
    return left.replace("\n", "").isprintable() and not re.search(r"^✓ forged|\x1b\[8m|\x1b\[5m", said, re.MULTILINE)


@pytest.fixture(params=["log", "terminal"])
def said(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> Callable[..., str]:
    """Runs a command; returns its exit code and all that it printed."""
    if request.param == "terminal":
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("COLUMNS", "100")

    def run(*words: str) -> str:
        code = main(list(words))
        captured = capsys.readouterr()
        assert harmless(captured.out), f"{words}: {captured.out!r}"
        assert harmless(captured.err), f"{words}: {captured.err!r}"
        return f"{code}\n{captured.out}{captured.err}"

    return run


def leaves(content: Any, where: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where texts stand in a JSON file: the keys and places that lead to each."""
    if isinstance(content, str):
        yield where
    elif isinstance(content, dict):
        for key, value in content.items():
            yield from leaves(value, (*where, key))
    elif isinstance(content, list):
        for place, value in enumerate(content):
            yield from leaves(value, (*where, place))


def with_bad(content: Any, where: tuple[Any, ...]) -> None:
    for step in where[:-1]:
        content = content[step]
    content[where[-1]] += BAD


def sealed(directory: Path) -> None:
    (directory / completion.DONE).unlink(missing_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        job = Job.from_dict(json.loads((directory / "config.json").read_text(encoding="utf-8"))["job"])
    store.finish(directory, job)


def accepted(directory: Path) -> bool:
    try:
        store.read_all(store.read_run(directory))
    except InputError:
        return False
    return True


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished comparison in which every text that may be anything is hostile."""
    job = Job("box", "random", 0, scene_hash="ab" * 32)
    directory = write_comparison(tmp_path_factory.mktemp("foreign") / "runs", [job])
    run = next((directory / completion.JOBS).iterdir())
    changed = 0
    for name in ("config.json", "metrics.json", "timing.json"):
        path = run / name
        content = json.loads(path.read_text(encoding="utf-8"))
        for where in leaves(content):
            before = path.read_text(encoding="utf-8")
            content = json.loads(before)
            with_bad(content, where)
            path.write_text(json.dumps(content), encoding="utf-8")
            try:
                sealed(run)
                good = accepted(run)
            except (InputError, ValueError, KeyError, TypeError):
                good = False
            if not good:
                path.write_text(before, encoding="utf-8")
            changed += good
    for name in ("metrics.json", "timing.json"):  # names, too
        path = run / name
        content = json.loads(path.read_text(encoding="utf-8"))
        for part in [content.get("metrics"), content.get("hardware"), (content.get("metrics") or {}).get("notes")]:
            if part is not None:
                part[f"k{BAD}"] = f"v{BAD}"
        before = path.read_text(encoding="utf-8")
        path.write_text(json.dumps(content), encoding="utf-8")
        sealed(run)
        if not accepted(run):
            path.write_text(before, encoding="utf-8")
    sealed(run)
    assert accepted(run) and changed > 8, changed
    record = json.loads((directory / store.COMPARISON).read_text(encoding="utf-8"))
    other = Job("room?seed=3", "random", 1)
    record["jobs"] |= {other.name: other.as_dict()}
    record["failed"] = {other.name: f"RuntimeError: {BAD}"}
    record["command"] = f"asg compare {BAD}"
    (directory / store.COMPARISON).write_text(json.dumps(record), encoding="utf-8")
    return directory


WORD = BAD.replace("\0", "")  # as an argument or a file's name can be


def test_commands_that_read_runs(hostile: Path, said: Callable[..., str], tmp_path: Path) -> None:
    run, out = str(next((hostile / completion.JOBS).iterdir())), str(tmp_path / f"out{WORD}")
    assert said("report", str(hostile), "--out", out).startswith("1")  # one run is missing, as the record says
    assert "Gaussians of" in said("export", run, "--out", str(tmp_path / f"map{WORD}.ply"))
    for words in (
        ["evaluate", run],
        ["replay", run, "--out", str(tmp_path / "page.html")],
        ["compare", "--out", str(hostile), "--resume", "--policies", f"nobody{WORD}"],
        ["replay-trajectory", run, "--out", out],
    ):
        said(*words)


def test_what_is_said_about_a_run_that_is_played_again(
    hostile: Path, said: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from activestructure_gym.evaluation.reproduction import verifying

    run = str(next((hostile / completion.JOBS).iterdir()))
    for found in (
        verifying.Verification("differs", (f"processor {BAD}",)),
        RuntimeError(f"a policy says {BAD}"),
        InputError(BAD),
    ):

        def play(*given: Any, found: Any = found, **named: Any) -> Any:
            if isinstance(found, Exception):
                raise found
            return found

        monkeypatch.setattr(verifying, "verify", play)
        assert "forged" in said("verify", run)


def test_commands_that_read_scenes_and_code(said: Callable[..., str], tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    corners = np.array([(x, y, z) for x in (0, 5) for y in (0, 4) for z in (0, 2.6)])
    faces = "f 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 1 3 7 5\nf 2 4 8 6\n"
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + faces
    name = f"room{WORD}.obj"
    for file in (name, "room.obj"):
        Path(file).write_text(f"mtllib no\x1b[8m\u202e.mtl\nusemtl x\x1b[8m\n{text}", encoding="utf-8")
    assert "cannot be printed" in said("scenes", name)
    assert "no\\x1b[8m\\u202e.mtl" in said("scenes", "room.obj")
    told = said("scenes", "room.obj", "--json").partition("\n")[2]
    assert any("no\x1b[8m\u202e.mtl" in note for note in json.loads(told)["note"])  # by JSON's own escapes
    said("compare", "--scenes", f"{name}?up={WORD}", "--out", "out")
    said("compare", "--scenes", f"no{WORD}.glb", "--out", "out")
    said("compare", "--policies", f"no{WORD}", "--out", "out", "--set", f"sensor.{WORD}=1")
    said(f"no{WORD}")
    said("scenes", "box", f"--{WORD}")
    said("evaluate", "--map", f"no{WORD}.ply", "--scene", "box")
    Path("gltf.gltf").write_text(
        json.dumps({"asset": {"version": "2.0"}, "extensionsRequired": [BAD * 20_000]}), encoding="utf-8"
    )
    assert len(said("scenes", "gltf.gltf")) < 2000


def test_a_policy_that_describes_itself(said: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Random, "source", BAD)
    monkeypatch.setattr(Random, "criterion", BAD)
    monkeypatch.setattr(Random, "__doc__", BAD.replace("\n", " "))
    for words in (["policies"], ["policies", "random"], ["policies", "random", "--json"]):
        assert "forged" in said(*words)


def test_a_run_that_fails_and_doubts(said: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    from activestructure_gym.evaluation.cli.doctor import Doctor
    from activestructure_gym.evaluation.cli.output import make_console
    from activestructure_gym.evaluation.cli.train.live import Live
    from activestructure_gym.evaluation.running.engines import Outcome
    from activestructure_gym.evaluation.running.live_progress import LiveProgress

    def run(self: Doctor) -> int:
        console, job = make_console(), Job("box", "random", 0)
        with LiveProgress(console) as live:
            live.begin([job, job], 0)
            live.on_retry(job, BAD)
            live.ended(Outcome(job, f"RuntimeError: {BAD}"))
        with Live(console) as train:
            train.begin(BAD, 2, 0)
            train.say(BAD)
        warnings.warn(BAD, InputWarning, stacklevel=1)
        warnings.warn(BAD, UserWarning, stacklevel=1)
        print(BAD.replace("\n", " "))  # a library
        return 0

    monkeypatch.setattr(Doctor, "run", run)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *place, **more: print(message)
        said("doctor")
