"""Checkpoints of learned policies, and training runs to go on with, damaged or made by an enemy."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

from tests.fuzz._archives import _episode, asg, damage, evil_module, in_folder, training_run, write
from tests.fuzz._mutations import damaged_bytes, damaged_json

CI_CASES = 25

_SIZES = (0, -1, 1, 3, 5, 64, 1023, 1024, 1025, 4096, 10**5, 10**6, 2**31, 2**63, 10**30, 1.5, "4", None, True, [4])
_FEATURES: tuple[Any, ...] = (
    [], "pixel", 5, None, [5], ["pixel"], ["pixel", "pixl"], ["pixel"] * 64, ["pixel"] * 10**5, {"pixel": 1},
    [["pixel"]],
)  # fmt: skip


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A training run in ``folder/run`` with some damage: its checkpoint is used, or it is gone on with."""
    files = dict(training_run())
    evil, mark = evil_module(folder, rng)
    resumed = rng.random() < 0.5
    checkpoint = [name for name in files if name.startswith("best.")]
    name = str(rng.choice(sorted(set(files) - set(checkpoint)) if resumed else checkpoint))
    if rng.random() < 0.1:
        name = "config.json" if resumed else "best.json"
        files[name] = files[name].replace(b'"pixel"', f'"{evil}:make"'.encode())
    elif name == "best.json" and rng.random() < 0.7:
        files[name] = _other_network(rng, files[name])
    elif name.endswith(".safetensors") and rng.random() < 0.7:
        files[name] = _other_header(rng, files[name])
    else:
        after = damage(rng, name, files.pop(name), training_run())
        if after is not None:
            files[name] = after
    write(files, folder / "run")
    return lambda: _use(folder, resumed, mark)


def _other_network(rng: np.random.Generator, content: bytes) -> bytes:
    """A description of another network, of any size."""
    described = json.loads(content)
    for _ in range(int(rng.integers(1, 3))):
        key = str(rng.choice(["planes", "candidates", "rounds", "features"]))
        values = _FEATURES if key == "features" else _SIZES
        described["network"][key] = values[rng.integers(len(values))]
    return json.dumps(described).encode()


def _other_header(rng: np.random.Generator, content: bytes) -> bytes:
    """A safetensors file whose header says something else: other shapes, kinds, places, notes or lengths."""
    (length,) = struct.unpack("<Q", content[:8])
    header, body = content[8 : 8 + length], content[8 + length :]
    kind = rng.integers(6)
    if kind == 0:
        other = int(rng.choice([0, 1, length - 1, length + 1, 2**20 + 1, 2**31, 2**62]))
        return struct.pack("<Q", other) + header + body
    if kind == 1:
        header = damaged_bytes(rng, header)
    elif kind == 2:
        header = damaged_json(rng, header)
    elif kind == 3:
        tree = json.loads(header)
        name = str(rng.choice(sorted(set(tree) - {"__metadata__"})))
        change = int(rng.integers(5))
        if change == 0:
            tree[name]["shape"] = [int(n) for n in rng.choice([0, 1, 4, 10**6, 10**18], 2)]
        elif change == 1:
            tree[name]["dtype"] = str(rng.choice(["F64", "I8", "BOOL", "U64", "BF16", "F8_E4M3", "X"]))
        elif change == 2:
            tree[name]["data_offsets"] = [int(n) for n in rng.choice([0, 4, 10**6, 10**18], 2)]
        elif change == 3:
            tree["x" * int(rng.choice([1, 300]))] = tree.pop(name)
        else:
            tree.setdefault("__metadata__", {})["training"] = str(rng.choice(["", "{}", "[]", "null", "[" * 9999]))
        header = json.dumps(tree).encode()
    elif kind == 4:
        body = body[: int(rng.integers(len(body)))] if rng.random() < 0.5 else body + bytes(8)
    else:  # numbers that are none
        values = np.frombuffer(body[: len(body) // 4 * 4], "<f4").copy()
        values[rng.integers(len(values), size=2)] = rng.choice([np.nan, np.inf, 3e38])
        body = values.tobytes()
    return struct.pack("<Q", len(header)) + header + body


def _use(folder: Path, resumed: bool, mark: Path) -> None:
    in_folder(folder)
    try:
        if resumed:
            _resume()
        else:
            _decide()
    finally:
        if mark.exists():
            raise AssertionError("code that a file names was run")


def _decide() -> None:
    """Take the checkpoint as a policy, and let it choose."""
    from activestructure_gym.policies import canonical_policy, make_policy

    canonical_policy("learned:run")
    policy: Any = make_policy("learned:run")
    policy.bind(policy.required_features)
    state = _episode(SimpleNamespace(world=SimpleNamespace(max_planes=4, features=policy.required_features)))
    policy.act({name: array[0] for name, array in state.items()})


def _resume() -> None:
    """Go on with the run; the episodes of validation and of missing demonstrations are made up."""
    place = "activestructure_gym.evaluation.training"
    played = SimpleNamespace(auc=0.5, frames=[1], coverage=[0.5])
    made_up = {
        f"{place}.validation.learning_layouts": lambda world, kind, count, *_: _specs(world, kind, count),
        f"{place}.validation.Layout": lambda spec: SimpleNamespace(truth=SimpleNamespace),
        f"{place}.validation.make_env": lambda *_: SimpleNamespace(close=lambda: None),
        f"{place}.validation.play": lambda *_: played,
        f"{place}.validation.play_policy": lambda *_: played,
        f"{place}.validation.play_oracle": lambda *_: played,
        f"{place}.demonstrations.record": lambda config, number: _episode(config),
    }
    with ExitStack() as stack:
        for name, replacement in made_up.items():
            stack.enter_context(mock.patch(name, replacement))
        asg("train", "bc", "--out", "run", "--resume", "--workers", "1")


def _specs(world: Any, kind: str, count: int) -> list[str]:
    from activestructure_gym.ground_truth.layouts import layout_specs

    return list(layout_specs(kind, min(count, 3), world.rooms))
