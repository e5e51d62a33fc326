"""Kernels are compiled once for all processes, told about in one line, and work where nothing can be kept."""

from __future__ import annotations

import errno
import io
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest
from numba.core import event

from activestructure_gym import compiling
from activestructure_gym.compiling import EPISODE_KERNELS, describe, kernel, told_to

ROOT = Path(__file__).resolve().parents[1]

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

# Compiles both, and says what it compiled and what came out.
USE = """
import sys, numpy
from activestructure_gym.compiling import told_to
import tiny
compiled = []
sys.stdin.readline()
with told_to(compiled.append):
    result = tiny.total(numpy.arange(4.0)), tiny.doubled(21.0)
print(*result, *compiled)
"""


@pytest.fixture
def package(tmp_path) -> Path:
    """A folder with a module of two kernels."""
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "tiny.py").write_text(TINY)
    return folder


def start(package: Path, code: str, *prefix: str, cache: Path | None = None, **options) -> subprocess.Popen[str]:
    """Python with the package on its path; without ``cache`` numba looks for a place itself."""
    environment = {**os.environ, "PYTHONPATH": f"{package}:{ROOT}", "XDG_CACHE_HOME": str(package.parent / "user")}
    environment.pop("NUMBA_CACHE_DIR", None)
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    options = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    command = [*prefix, sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.Popen(command, env=environment, text=True, **options)


def run(*arguments, **options) -> tuple[str, str]:
    """What a process wrote on standard output and standard error; it must end well."""
    process = start(*arguments, **options)
    out, err = process.communicate("go\n", timeout=120)
    assert process.returncode == 0, err
    return out.strip(), err


RESULT = "12.0 42.0"
BOTH = "tiny.total tiny.doubled"


def test_the_line() -> None:
    assert describe(7, 12.3) == f"compiling kernels, once per installation: 7 of about {EPISODE_KERNELS}, 12 s"
    assert describe(EPISODE_KERNELS + 1, 30) == (
        f"compiling kernels, once per installation: {EPISODE_KERNELS + 1}, 30 s"
    )


def test_a_log_gets_one_line_and_none_when_all_is_compiled(package, tmp_path) -> None:
    code = "import numpy, tiny; tiny.total(numpy.ones(3)); print(tiny.doubled(2))"
    line = "compiling kernels, once per installation (half a minute)\n"
    assert run(package, code, cache=tmp_path / "cache") == ("4", line)
    assert run(package, code, cache=tmp_path / "cache") == ("4", "")


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no terminals here")
def test_a_terminal_gets_a_line_that_counts_and_goes_away(package, tmp_path) -> None:
    ours, theirs = os.openpty()
    code = "import numpy, tiny; print(tiny.total(numpy.ones(3)), tiny.doubled(2))"
    out, _ = run(package, code, cache=tmp_path / "cache", stderr=theirs)
    os.close(theirs)
    shown = os.read(ours, 10_000).decode()
    os.close(ours)
    assert out == "6.0 4" and "\n" not in shown
    lines = [line for line in shown.split("\r") if line.strip()]
    assert lines[0].startswith(f"compiling kernels, once per installation: 1 of about {EPISODE_KERNELS}, ")
    assert lines[-1].startswith(f"compiling kernels, once per installation: 2 of about {EPISODE_KERNELS}, ")
    # Blanks over the last line, and the cursor at its beginning.
    assert shown.endswith("\r" + " " * len(lines[-1]) + "\r")


def test_processes_that_start_together_compile_everything_once(package, tmp_path) -> None:
    processes = [start(package, USE, cache=tmp_path / "cache") for _ in range(3)]
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    written = [process.communicate(timeout=120) for process in processes]
    assert [process.returncode for process in processes] == [0, 0, 0], written
    assert all(out.startswith(RESULT) for out, _ in written)
    compiled = [name for out, _ in written for name in out.removeprefix(RESULT).split()]
    assert sorted(compiled) == sorted(BOTH.split())
    assert run(package, USE, cache=tmp_path / "cache")[0] == RESULT


HOLD = """
import sys
from activestructure_gym import compiling
assert compiling._LOCKS.take("tiny.total") and compiling._LOCKS.usable
print("held", flush=True)
sys.stdin.readline()
"""


@pytest.mark.skipif(compiling.fcntl is None, reason="no locks between processes here")
def test_a_killed_process_keeps_no_lock(package, tmp_path) -> None:
    holder = start(package, HOLD, cache=tmp_path / "cache")
    assert holder.stdout.readline() == "held\n"
    waiting = start(package, "import numpy, tiny; print(tiny.total(numpy.ones(3)))", cache=tmp_path / "cache")
    assert waiting.stderr.readline() == "compiling kernels, once per installation (half a minute)\n"
    assert waiting.poll() is None
    holder.send_signal(signal.SIGKILL)
    out, err = waiting.communicate(timeout=120)
    holder.communicate()
    assert (out, err, waiting.returncode) == ("6.0\n", "", 0)


@pytest.mark.skipif(compiling.fcntl is None, reason="no locks between processes here")
def test_nobody_waits_for_a_stopped_process_for_ever(package, tmp_path) -> None:
    holder = start(package, HOLD, cache=tmp_path / "cache")
    assert holder.stdout.readline() == "held\n"
    code = """
        import numpy, tiny
        from activestructure_gym import compiling
        compiling._PATIENCE = 0.2
        print(tiny.total(numpy.ones(3)))
    """
    assert run(package, code, cache=tmp_path / "cache")[0] == "6.0"
    holder.communicate("end\n")


def test_beside_the_source_else_in_the_users_cache(package, tmp_path) -> None:
    assert run(package, USE)[0] == f"{RESULT} {BOTH}"
    assert list((package / "__pycache__").glob("tiny.total-*.nbi"))
    assert not (tmp_path / "user").exists()


@pytest.mark.skipif(os.name != "posix", reason="permission bits")
def test_in_a_read_only_installation_the_users_cache_is_used(package, tmp_path) -> None:
    prefix = ()
    if os.geteuid() == 0:  # permissions do not bind root, unless it gives that up
        if shutil.which("setpriv") is None:
            pytest.skip("no setpriv to give up root's rights")
        prefix = ("setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override")
    package.chmod(0o500)
    assert run(package, USE, *prefix)[0] == f"{RESULT} {BOTH}"
    assert run(package, USE, *prefix)[0] == RESULT
    assert not (package / "__pycache__").exists()
    assert list((tmp_path / "user" / "numba").rglob("tiny.total-*.nbi"))


def test_where_nothing_can_be_kept_kernels_work_after_one_warning(package, tmp_path) -> None:
    # A file where a folder should be stops root, too.
    (package / "__pycache__").touch()
    (tmp_path / "user").touch()
    out, err = run(package, USE)
    assert out == f"{RESULT} {BOTH}"
    assert err.count("Warning") == 1 and "NUMBA_CACHE_DIR" in err
    assert run(package, USE, cache=tmp_path / "given")[1] == ""  # the remedy


def test_a_full_disk_costs_a_warning(tmp_path, monkeypatch) -> None:
    from numba import config
    from numba.core.caching import IndexDataCacheFile

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(IndexDataCacheFile, "_save_data", full)
    monkeypatch.setattr(compiling, "_WARNED", [])

    @kernel
    def tripled(x):
        return 3 * x

    with pytest.warns(UserWarning, match="No space left.*NUMBA_CACHE_DIR"):
        assert tripled(2) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tripled(2.5) == 7.5


def test_division_by_zero_is_numpys(tmp_path, monkeypatch) -> None:
    from numba import config

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))

    @kernel
    def inverse(x):
        return 1.0 / x

    with told_to(lambda name: None):
        assert inverse(0.0) == np.inf


def test_an_error_in_a_kernel_leaves_no_lock(tmp_path, monkeypatch) -> None:
    from numba import config
    from numba.core.errors import TypingError

    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))

    @kernel
    def wrong(x):
        return x.no_such_thing

    dropped = []
    monkeypatch.setattr(compiling._LOCKS, "drop", dropped.append)
    with told_to(lambda name: None), pytest.raises(TypingError):
        wrong(1.0)
    assert dropped == [f"{__name__}.test_an_error_in_a_kernel_leaves_no_lock.<locals>.wrong"]


class Terminal(io.StringIO):
    """Says that it is one."""

    def isatty(self) -> bool:
        return True


def test_beside_a_spinner_the_line_is_a_plain_one(tmp_path, monkeypatch) -> None:
    from numba import config

    # rich puts an object of its own in the place of sys.stderr while a spinner turns.
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling._LOCKS, "take", lambda name: True)  # another process may be the one that tells
    monkeypatch.setattr(compiling._LOCKS, "drop", lambda name: None)
    monkeypatch.setattr(compiling, "_VOICE", voice := compiling._Voice())
    monkeypatch.setattr(sys, "stderr", Terminal())

    @kernel
    def halved(x):
        return x / 2

    event.register("numba:compile", voice)
    try:
        assert halved(3) == 1.5
        assert halved(3.0) == 1.5
    finally:
        event.unregister("numba:compile", voice)
    assert sys.stderr.getvalue() == "compiling kernels, once per installation (half a minute)\n"


ENVIRONMENTS = """
import gymnasium, numpy
from gymnasium.vector import AsyncVectorEnv


def make():
    return gymnasium.make(
        "activestructure_gym:ActiveStructure/Room-v0", scene="box", preset="fast", config={"frame_budget": 12}
    )


if __name__ == "__main__":
    environments = AsyncVectorEnv([make, make], context="spawn")
    observations = [environments.reset(seed=[3, 3])[0]]
    for _ in range(2):
        actions = observations[-1]["action_mask"].argmax(axis=1)
        observations.append(environments.step(actions)[0])
    environments.close()
    same = [numpy.array_equal(*values) for each in observations for values in each.values()]
    print(all(same), len(same) > 20)
"""

ONE = """
import sys
sys.path.insert(0, "SCRIPTS")
from together import make
from activestructure_gym.compiling import told_to
compiled = []
with told_to(compiled.append):
    environment = make()
    observation, _ = environment.reset(seed=3)
    environment.step(int(observation["action_mask"].argmax()))
print(*compiled)
"""


@pytest.mark.slow
def test_spawned_environments_on_a_fresh_installation(tmp_path) -> None:
    (tmp_path / "together.py").write_text(ENVIRONMENTS)
    cache = tmp_path / "cache"
    script = tmp_path / "together.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)}
    first = subprocess.run(
        [sys.executable, str(script)], env=environment, capture_output=True, text=True, timeout=600, check=True
    )
    assert first.stdout == "True True\n"
    assert first.stderr.count("compiling kernels, once per installation") == 1, first.stderr
    kernels = len(list(cache.rglob("*.nbi")))
    assert 0.8 * EPISODE_KERNELS < kernels < 1.2 * EPISODE_KERNELS
    # What two processes wrote at the same time can be read.
    assert run(tmp_path, ONE.replace("SCRIPTS", str(tmp_path)), cache=cache)[0] == ""
