"""Finished runs changed by somebody who knows how, and what `asg verify` says of them.

Every change is sealed with new checksums. Half of the runs claim another processor, some other versions. A run of which
a byte changed is never called identical, and an unchanged one always is. The play is replaced by the true run, so the
comparison alone is tested.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from tests.fuzz._archives import Files, comparison, damage, in_folder, runs_of, seal, write

CI_CASES = 20

_CHANGED = (
    "metrics.json",
    "steps.jsonl",
    "trajectory.npz",
    "graph.npz",
    "pictures.npz",
    "map.npz",
    "map.ply",
    "decisions.npz",
)
_EXIT_CODES = {"identical": 0, "differs": 1, "damaged": 1, "not comparable here": 3}


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A comparison in ``folder/all`` of which one run was changed."""
    true = comparison()
    files, runs = dict(true), runs_of(true)
    run = str(rng.choice(runs))
    other = next(name for name in runs if name != run)
    kind = rng.integers(5)
    if kind == 0:  # files of the other run
        for name in rng.choice(_CHANGED, int(rng.integers(1, 1 + len(_CHANGED))), replace=False):
            files[f"{run}/{name}"] = files[f"{other}/{name}"]
    elif kind == 1:
        name = f"{run}/{rng.choice(_CHANGED)}"
        after = damage(rng, name, files[name], files)
        files.pop(name)
        if after is not None:
            files[name] = after
    elif kind < 4:
        files[f"{run}/metrics.json"] = _better(rng, files[f"{run}/metrics.json"])
    if rng.random() < 0.5:
        _edit(files, f"{run}/timing.json", lambda content: content["hardware"].update(processor="another one"))
    if rng.random() < 0.2:
        _edit(files, f"{run}/config.json", lambda content: content["versions"].update(numpy="1.0"))
    seal(files, run)
    write(files, folder / "all")
    (folder / "run.json").write_text(json.dumps(run))
    changed = any(files.get(f"{run}/{name}") != true[f"{run}/{name}"] for name in _CHANGED[:-1])
    if f"{run}/map.ply" in files:  # which may be deleted
        changed |= files[f"{run}/map.ply"] != true[f"{run}/map.ply"]
    return lambda: _check(folder, run, true, changed=changed)


def _better(rng: np.random.Generator, content: bytes) -> bytes:
    """Numbers of the run, or of its curve, a little or much better; or lists with an entry more or less."""
    tree = json.loads(content)
    metrics = tree["metrics"]
    names = [name for name, value in metrics.items() if isinstance(value, int | float)]
    for name in rng.choice(names, int(rng.integers(1, 5)), replace=False):
        metrics[name] += type(metrics[name])(rng.choice([1, 2, 30])) if rng.random() < 0.5 else 1
    kind = rng.integers(4)
    if kind == 0:
        for point in tree["curve"]:
            point["completion_ratio"] = 99.0
    elif kind == 1:
        chosen = (tree["curve"], metrics["views"])[rng.integers(2)]
        chosen.append(chosen[-1]) if rng.random() < 0.5 else chosen.pop()
    return json.dumps(tree, indent=1).encode() + b"\n"


def _edit(files: Files, name: str, act: Callable[[Any], None]) -> None:
    if name in files:
        content = json.loads(files[name])
        act(content)
        files[name] = json.dumps(content, indent=1).encode() + b"\n"


def _check(folder: Path, run: str, true: Files, *, changed: bool) -> None:
    from activestructure_gym.evaluation.archive.store import read_run
    from activestructure_gym.evaluation.cli import main

    in_folder(folder)
    played = write({name: content for name, content in true.items() if name.startswith(f"{run}/")}, folder / "true")

    def again(job: Any, directory: Path, tell: Any, *, world: Any) -> Any:
        (played / run).rename(directory)
        return read_run(directory)

    said = io.StringIO()
    with _replaced(again), contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
        code = main(["verify", f"all/{run}"])
    text = said.getvalue()
    if "cannot be played here" in text:
        raise AssertionError(text[:500])
    verdicts = [verdict for verdict in _EXIT_CODES if f": {verdict}" in text or f"{verdict}: " in text]
    if code not in {_EXIT_CODES[verdict] for verdict in verdicts}:
        raise AssertionError(f"exit code {code} of {text[:300]!r}")
    if (code == 0) == changed:
        raise AssertionError(f"a run that was {'' if changed else 'not '}changed: {text[:500]!r}")


@contextlib.contextmanager
def _replaced(play: Callable[..., Any]) -> Iterator[None]:
    with mock.patch("activestructure_gym.evaluation.reproduction.verifying.run_job", play):
        yield
