"""A folder with a module of two kernels, and processes that use it."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from activestructure_gym.compiling import files

ROOT = Path(__file__).resolve().parents[2]

TINY = """
from activestructure_gym.compiling import kernel

@kernel
def doubled(x):
    return 2 * x

@kernel
def total(x):
    result = 0.0
    for value in x:
        result += doubled(value)
    return result
"""


@pytest.fixture
def package(tmp_path) -> Path:
    """A folder with ``tiny.py``."""
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "tiny.py").write_text(TINY)
    return folder


@pytest.fixture(scope="session")
def start() -> Callable[..., subprocess.Popen[str]]:
    """Starts Python with a folder on its path; without ``cache`` numba looks for a place itself."""

    def call(folder: Path, code: str, *arguments: str, prefix=(), cache: Path | None = None, **options):
        environment = {**os.environ, "PYTHONPATH": f"{folder}:{ROOT}", "XDG_CACHE_HOME": str(folder.parent / "user")}
        environment["PYTHONDONTWRITEBYTECODE"] = "1"  # bytecode takes an edit of the same length and second for none
        environment.pop("NUMBA_CACHE_DIR", None)
        if cache is not None:
            environment["NUMBA_CACHE_DIR"] = str(cache)
        options = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
        command = [*prefix, sys.executable, "-c", textwrap.dedent(code), *arguments]
        return subprocess.Popen(command, env=environment, cwd=folder, text=True, **options)

    return call


@pytest.fixture(scope="session")
def run(start) -> Callable[..., tuple[str, str]]:
    """What such a process wrote on standard output and standard error; it must end well."""

    def call(*arguments, **options) -> tuple[str, str]:
        process = start(*arguments, **options)
        out, err = process.communicate("go\n", timeout=120)
        assert process.returncode == 0, err
        return out.strip(), err

    return call


@pytest.fixture
def kept(tmp_path, monkeypatch) -> Path:
    """Where the kernels of this process are kept meanwhile, whatever else of numba's environment changes.

    Before it compiles, numba reads its whole configuration again where a variable NUMBA_* has changed since the last
    time, as by a test before this one: the place must stand in the environment, and that must be what was read last.
    """
    from numba import config

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    read = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_")}
    monkeypatch.setattr(config._env_reloader, "old_environ", read)
    monkeypatch.setattr(files, "not_kept", [])
    return tmp_path
