"""Machine code is used as long as nothing has changed that it depends on, in whatever file, and no longer."""

from __future__ import annotations

import importlib
import shutil
import sys
import time
from collections import namedtuple
from enum import IntEnum
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numba import njit, typeof

from activestructure_gym.compiling import files, kernel, stamps, told_to
from activestructure_gym.compiling.stamps import files_of, identity_of, stamp_of

ROOT = Path(__file__).resolve().parents[2]

SOURCES = {
    "__init__.py": "",
    "numbers.py": "FACTOR = 2.0\nTABLE = (1, 2, 3)\n",
    "deep.py": "from activestructure_gym.compiling import kernel\n\n@kernel\ndef deepest(x):\n    return x + 1.0\n",
    "middle.py": """
from numba import njit
from synthetic import deep

@njit(error_model="numpy")
def scaled(x):
    return 10.0 * deep.deepest(x)
""",
    "top.py": """
from activestructure_gym.compiling import kernel
from synthetic import middle
from synthetic.numbers import FACTOR

@kernel
def topmost(x):
    return FACTOR * middle.scaled(x)
""",
    "apart.py": "UNUSED = 1\n",
}


@pytest.fixture
def synthetic(tmp_path, monkeypatch) -> Path:
    """A package in which a kernel depends on three other files: two calls away, and for a constant."""
    folder = tmp_path / "package" / "synthetic"
    folder.mkdir(parents=True)
    for name, text in SOURCES.items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def loaded(synthetic, monkeypatch):
    """Imports the package anew, as another process would."""
    monkeypatch.syspath_prepend(str(synthetic.parent))
    monkeypatch.setattr(stamps, "_BEGAN", float("inf"))

    def load():
        for name in [name for name in sys.modules if name.partition(".")[0] == "synthetic"]:
            del sys.modules[name]
        shutil.rmtree(synthetic / "__pycache__", ignore_errors=True)
        importlib.invalidate_caches()
        stamps._digest_of_file.cache_clear()
        return importlib.import_module("synthetic.top").topmost.py_func

    yield load
    stamps._digest_of_file.cache_clear()


def test_the_files_of_a_kernel(loaded):
    assert {Path(file).name for file in files_of(loaded())} == {"top.py", "middle.py", "deep.py"}


EDITS = [
    ("top.py", "FACTOR *", "-FACTOR *", True),
    ("middle.py", "10.0", "11.0", True),
    ("middle.py", '"numpy"', '"python"', True),
    ("deep.py", "+ 1.0", "+ 2.0", True),
    ("numbers.py", "2.0", "3.0", True),
    ("numbers.py", "(1, 2, 3)", "(4,)", False),
    ("numbers.py", "FACTOR = 2.0", "FACTOR = 1.0 + 1.0  # the same", False),
    ("apart.py", "1", "2", False),
]


@pytest.mark.parametrize("file, old, new, another", EDITS)
def test_the_stamp_follows_what_the_kernel_depends_on(synthetic, loaded, file, old, new, another):
    before = stamp_of(loaded())
    assert before is not None and stamp_of(loaded()) == before
    text = (synthetic / file).read_text()
    assert old in text
    (synthetic / file).write_text(text.replace(old, new))
    assert (stamp_of(loaded()) != before) == another


def test_a_process_whose_sources_have_changed_keeps_nothing(synthetic, loaded, monkeypatch):
    function = loaded()
    monkeypatch.setattr(stamps, "_BEGAN", time.time() + 1)
    assert stamp_of(function) is not None
    monkeypatch.setattr(stamps, "_BEGAN", 0.0)
    stamps._digest_of_file.cache_clear()
    assert stamp_of(function) is None


class Colour(IntEnum):
    RED = 1


@njit
def helper(x):
    return x


@njit
def other_helper(x):
    return -x


def reads(value):
    def function(x):
        return value if x else None

    return function


VALUES = [
    (1, 2), (1, 1.0), (1, True), (0.0, -0.0), (np.float32(1), np.float64(1)), ((1, 2), (1, 3)), ("a", "b"),
    (np.arange(3), np.arange(3.0)), (np.zeros(4), np.zeros((2, 2))), (np.zeros(2), np.array([0.0, 1.0])),
    (helper, other_helper), ((helper, 1), (helper, 2)), (Colour.RED, 1), (partial(helper, 1), partial(helper, 2)),
    (np.float32, np.float64),
]  # fmt: skip


@pytest.mark.parametrize("first, second", VALUES)
def test_constants_count_by_their_value(first, second):
    assert stamp_of(reads(first)) == stamp_of(reads(first)) != stamp_of(reads(second))


def test_what_a_factory_makes_has_files_of_its_own():
    assert identity_of(reads(1)) == identity_of(reads(1)) != identity_of(reads(2))
    assert identity_of(reads(helper)) != identity_of(reads(other_helper))


def test_named_tuples_with_other_fields_are_other_arguments():
    first, same, other = (namedtuple("Pinhole", fields) for fields in ("fx fy", "fx fy", "fy fx"))
    described = [files._fields((typeof(kind(1.0, 2.0)), typeof(1))) for kind in (first, same, other)]
    assert described[0] == described[1] != described[2]
    assert files._fields(typeof(((first(1, 2), 3), 1))) != files._fields(typeof(((other(1, 2), 3), 1)))
    assert files._fields((typeof(np.zeros(3)), typeof(1))) == ""


def test_a_function_as_an_argument_is_not_kept(kept):
    @kernel
    def applied(function, x):
        return function(x)

    with told_to(lambda name: None):
        assert applied(helper, 3) == 3
    assert not list(kept.rglob("*.kernel"))


def test_kernels_call_what_is_defined_after_them(kept):
    @kernel
    def first(x):
        return later(x)

    @kernel
    def later(x):
        return x + 1

    with told_to(lambda name: None):
        assert first(1) == 2
    assert len(list(kept.rglob("*.kernel"))) == 2


CHAIN = "from synthetic.top import topmost; print(topmost(1.0))"


def test_an_edit_two_calls_away_reaches_every_other_process(synthetic, run, tmp_path):
    asked = synthetic.parent, CHAIN
    assert run(*asked, cache=tmp_path)[0] == "40.0"
    (synthetic / "deep.py").write_text(SOURCES["deep.py"].replace("1.0", "4.0"))
    assert run(*asked, cache=tmp_path)[0] == "100.0"
    (synthetic / "numbers.py").write_text("FACTOR = 3.0\n")
    assert run(*asked, cache=tmp_path)[0] == "150.0"
    assert run(*asked, cache=tmp_path) == ("150.0", "")


EDGE = """
import numpy as np
from activestructure_gym.motion.clearance import _first_blocked_edge
print(_first_blocked_edge(np.ones((4, 4, 4), np.float32), np.array([[1.0, 1, 1], [2, 2, 2]]), 0.5, 5.0))
"""
SPAWNED = """
import multiprocessing, os, sys
if __name__ == "__main__":
    process = multiprocessing.get_context("spawn").Process(target=exec, args=(sys.argv[1],))
    process.start()
    process.join()
"""


@pytest.mark.slow
def test_a_collision_check_follows_the_distance_field(run, tmp_path):
    folder = tmp_path / "copy"
    for package in ("activestructure_gym", "envs"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    options = {"cache": tmp_path / "cache"}
    assert run(folder, EDGE, **options)[0] == "-1"
    field = folder / "activestructure_gym" / "volume" / "distance_field.py"
    text = field.read_text()
    assert text.count("    total = 0.0\n") == 1
    field.write_text(text.replace("    total = 0.0\n", "    total = -9.0\n"))
    assert run(folder, SPAWNED, EDGE, **options)[0] == "0"
    assert run(folder, EDGE, **options) == ("0", "")
