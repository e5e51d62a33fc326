"""Damaged trajectory files of every format that is one file."""

from __future__ import annotations

import contextlib
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
    from activestructure_gym.errors import InputError
    from activestructure_gym.evaluation.trajectories.alignment import matched, trajectory_errors, umeyama
    from activestructure_gym.evaluation.trajectories.formats import read_recorded
    from activestructure_gym.evaluation.trajectories.keyframes import listed_poses

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = read_recorded(file, kind)
    poses, stamps = found.poses, found.stamps
    assert np.isfinite(poses).all() and (stamps is None or len(stamps) == len(poses))
    with contextlib.suppress(InputError):  # the file as a list of keyframes
        assert listed_poses(file, len(poses), stamps).any()
    with contextlib.suppress(InputError):  # the file as its own reference
        ours, theirs = matched(len(poses), stamps, len(poses), stamps)
        assert all(np.isfinite(value) for value in trajectory_errors(poses[ours], poses[theirs]).values())
        assert umeyama(poses[ours, :3, 3], poses[theirs, :3, 3], with_scale=True).scale > 0
