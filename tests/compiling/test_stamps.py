"""Machine code is used as long as nothing has changed that it depends on, in whatever file, and no longer."""

from __future__ import annotations

import ast
import importlib
import re
import shutil
import sys
import time
from collections import namedtuple
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numba import njit, typeof

from activestructure_gym.compiling import files, kernel, stamps, told_to
from activestructure_gym.compiling.stamps import files_of, stamp_of
from tests.parsed import tree

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
    "order.py": """
from activestructure_gym.compiling import kernel

@kernel
def first(x):
    return later(x)

@kernel
def later(x):
    return x + 1
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
        forget()
        return importlib.import_module("synthetic.top").topmost.py_func

    yield load
    forget()


def forget() -> None:
    """Let stamps be those of the files as they are now."""
    stamps._read.cache_clear()
    files_of.cache_clear()


def test_the_files_of_a_kernel(loaded):
    function = loaded()
    found = files_of(function.__code__.co_filename, function.__module__)
    assert {Path(file).name for file in found} == {"top.py", "middle.py", "deep.py", "numbers.py", "__init__.py"}


EDITS = [
    ("top.py", "FACTOR *", "-FACTOR *", True),
    ("middle.py", "10.0", "11.0", True),
    ("middle.py", '"numpy"', '"python"', True),
    ("deep.py", "+ 1.0", "+ 2.0", True),
    ("numbers.py", "2.0", "3.0", True),
    ("numbers.py", "(1, 2, 3)", "(4,)", True),  # a file counts as a whole
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
    stamps._read.cache_clear()
    assert stamp_of(function) is None


def test_a_kernel_that_reads_variables_around_it_is_not_kept(kept):
    def made(factor):
        @kernel
        def scaled(x):
            return factor * x

        return scaled

    with told_to(lambda name: None):
        assert [made(factor)(3) for factor in (2, 5)] == [6, 15]
    assert not list(kept.rglob("*.kernel")) and stamp_of(made(2).py_func) is None


def test_named_tuples_with_other_fields_are_other_arguments():
    first, same, other = (namedtuple("Pinhole", fields) for fields in ("fx fy", "fx fy", "fy fx"))
    described = [files._fields((typeof(kind(1.0, 2.0)), typeof(1))) for kind in (first, same, other)]
    assert described[0] == described[1] != described[2]
    assert files._fields(typeof(((first(1, 2), 3), 1))) != files._fields(typeof(((other(1, 2), 3), 1)))
    assert files._fields((typeof(np.zeros(3)), typeof(1))) == ""


@njit
def unchanged(x):
    return x


def test_a_function_as_an_argument_is_not_kept(kept):
    @kernel
    def applied(function, x):
        return function(x)

    with told_to(lambda name: None):
        assert applied(unchanged, 3) == 3
    assert not list(kept.rglob("*.kernel"))


def test_kernels_call_what_is_defined_after_them(synthetic, loaded, kept):
    loaded()
    with told_to(lambda name: None):
        assert importlib.import_module("synthetic.order").first(1) == 2
    assert len(list(kept.rglob("order.*.kernel"))) == 2


COMPILED = re.compile(r"\b(kernel|njit|inline|_inline|intrinsic)\b")


class Source:
    """Hold what a source file defines and what it imports from this package."""

    def __init__(self, path: str) -> None:
        body = tree(Path(path)).body
        self.compiled = stamps._read(path)[2]  # else nothing that it imports is covered
        self.defined: dict[str, ast.stmt] = {}
        self.imported: set[str] = set()
        for node in body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                self.defined[node.name] = node
            for target in getattr(node, "targets", [getattr(node, "target", None)]):
                names = [part.id for part in ast.walk(target) if isinstance(part, ast.Name)] if target else []
                self.defined |= dict.fromkeys(names, node)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("activestructure_gym"):
                if node.module != "activestructure_gym.compiling":
                    self.imported |= {alias.asname or alias.name for alias in node.names}
        self.used = [(name, names_in(node) & self.imported) for name, node in self.defined.items() if is_compiled(node)]


def is_compiled(node: ast.stmt) -> bool:
    return bool(COMPILED.search(" ".join(map(ast.unparse, getattr(node, "decorator_list", [])))))


def names_in(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def test_stamps_cover_every_file_from_which_a_compiled_function_has_something():
    """What such a function names is defined in a file of the stamp, and not from a file further away."""
    source, checked = cache(Source), 0
    package = Path(stamps.__file__).resolve().parents[1]
    for folder in (package, *((package / room).resolve() for room in ("envs", "policies", "evaluation"))):
        for path in folder.rglob("*.py"):
            if "@kernel" not in path.read_text(encoding="utf-8"):
                continue
            parts = path.relative_to(folder).with_suffix("").parts
            room = () if folder.name == "activestructure_gym" else (folder.name,)
            module = importlib.import_module(".".join(("activestructure_gym", *room, *parts)))
            covered = {file: source(file) for file in files_of(module.__file__, module.__name__)}
            modules = {Path(file).stem for file in covered}
            for file in (file for file, about in covered.items() if about.compiled):
                for name, names in covered[file].used:
                    for used in names:
                        places = [about for about in covered.values() if used in about.defined]
                        assert places or used in modules, (file, name, used)
                        for place in places:  # a constant may be made of another
                            found = place.defined[used]
                            if isinstance(found, ast.Assign) and not place.compiled:
                                for more in names_in(found.value) & place.imported:
                                    assert any(more in about.defined for about in covered.values()), (used, more)
                        checked += 1
    assert checked > 300


def test_an_edit_two_calls_away_reaches_the_next_process(synthetic, loaded, kept):
    with told_to(lambda name: None):
        loaded()
        assert sys.modules["synthetic.top"].topmost(1.0) == 40.0
        (synthetic / "deep.py").write_text(SOURCES["deep.py"].replace("1.0", "4.0"))
        loaded()
        assert sys.modules["synthetic.top"].topmost(1.0) == 100.0
        loaded()
        again = sys.modules["synthetic.top"].topmost
        assert again(1.0) == 100.0 and sum(again.stats.cache_hits.values()) == 1


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
