"""What all tests share."""

from __future__ import annotations

import gc
import os
import sys
import time
from pathlib import Path

# Before torch or numba load: spinning OpenMP threads of two test workers cost each other a factor of 35.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Without bytecode every process that a test starts compiles every module again: half of the suite's time.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np
import pytest

sys.dont_write_bytecode = False
# Syntax trees, modules and thousands of tests are many objects: by its own thresholds the collector takes an eighth of
# all time.
gc.set_threshold(20_000, 20, 20)
ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("ASG_SHARED", ROOT.parent / "shared"))
BEGAN = time.monotonic()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin at file number ASG_TEST_TURN and go round: what CI has no time for in one turn it has in another."""
    turn = os.environ.get("ASG_TEST_TURN")
    if turn is not None:
        files = sorted({item.path for item in items})
        begin = int(turn) % max(len(files), 1)
        place = {path: n for n, path in enumerate(files[begin:] + files[:begin])}
        items.sort(key=lambda item: place[item.path])


def pytest_collection_finish() -> None:
    """Keep modules and collected tests out of every garbage collection to come."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip the slow tests that would begin later than ASG_TEST_SECONDS after their worker did."""
    seconds = os.environ.get("ASG_TEST_SECONDS")
    if seconds is not None and item.get_closest_marker("slow") and time.monotonic() - BEGAN > float(seconds):
        pytest.skip(f"the {seconds} s of ASG_TEST_SECONDS are over")


@pytest.fixture
def rng() -> np.random.Generator:
    """A fresh generator with a fixed seed."""
    return np.random.default_rng(7)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real scenes and frames beside the checkout; the test is skipped where it is absent."""
    if not (SHARED / "scenes").is_dir():
        pytest.skip(f"{SHARED} is not here")
    return SHARED


@pytest.fixture(scope="session")
def cast_boxes():
    """Makes a ray caster over axis-aligned boxes, each (lower, upper) in metres."""
    import trimesh

    from activestructure_gym.scenes.raycaster import RayCaster

    def make(*bounds) -> RayCaster:
        parts = []
        for lower, upper in bounds:
            lower, upper = np.array(lower, float), np.array(upper, float)
            part = trimesh.creation.box(extents=upper - lower)
            part.apply_translation((lower + upper) / 2)
            parts.append(part)
        mesh = trimesh.util.concatenate(parts)
        return RayCaster(mesh.vertices, mesh.faces, threads=1)

    return make


@pytest.fixture(autouse=True)
def no_width(monkeypatch):
    """Print as into a log of any width, whatever the shell that runs the tests says."""
    for name in ("COLUMNS", "LINES", "FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
