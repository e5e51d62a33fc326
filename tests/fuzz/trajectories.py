"""Damaged trajectory files of every format that is one file."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.evaluation.trajectories.test_formats import LINES, MODEL
from tests.fuzz._mutations import damaged_bytes, damaged_json, damaged_text

CI_CASES = 300


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    kind = str(rng.choice([*LINES, "images.bin"]))
    data = MODEL if kind == "images.bin" else LINES[kind].encode()
    damage = damaged_bytes if kind == "images.bin" or rng.random() < 0.2 else damaged_text
    if kind in ("nerfstudio", "habitat") and rng.random() < 0.7:
        damage = damaged_json
    file = folder / "poses"
    file.write_bytes(damage(rng, data))
    asked = "auto" if kind == "images.bin" or rng.random() < 0.5 else kind
    return lambda: _read(file, asked)


def _read(file: Path, kind: str) -> None:
    from activestructure_gym.evaluation.trajectories.formats import read_recorded

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = read_recorded(file, kind)
    assert np.isfinite(found.poses).all() and (found.stamps is None or len(found.stamps) == len(found.poses))
