"""Kernels are compiled once for all processes, and work where nothing can be kept."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.compiling import files, kernel, progress, told_to
from activestructure_gym.compiling.files import read
from activestructure_gym.compiling.locks import LOCKS
from activestructure_gym.errors import InputError

ROOT = Path(__file__).resolve().parents[2]

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

RESULT = "12.0 42.0"
BOTH = "tiny.total tiny.doubled"


def test_beside_the_source_else_in_the_users_cache(package, run, tmp_path) -> None:
    assert run(package, USE)[0] == f"{RESULT} {BOTH}"
    assert list((package / "__pycache__").glob("tiny.total-*.kernel"))
    assert not (tmp_path / "user").exists()


@pytest.mark.skipif(os.name != "posix", reason="permission bits")
def test_in_a_read_only_installation_the_users_cache_is_used(package, run, tmp_path) -> None:
    prefix = ()
    if os.geteuid() == 0:  # permissions do not bind root, unless it gives that up
        if shutil.which("setpriv") is None:
            pytest.skip("no setpriv to give up root's rights")
        prefix = ("setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override")
    package.chmod(0o500)
    assert run(package, USE, prefix=prefix)[0] == f"{RESULT} {BOTH}"
    assert run(package, USE, prefix=prefix)[0] == RESULT
    assert not (package / "__pycache__").exists()
    assert list((tmp_path / "user" / "numba").rglob("tiny.total-*.kernel"))


def test_where_nothing_can_be_kept_kernels_work_after_one_warning(package, run, tmp_path) -> None:
    # A file where a folder should be stops root, too.
    (package / "__pycache__").touch()
    (tmp_path / "user").touch()
    out, err = run(package, USE)
    assert out == f"{RESULT} {BOTH}"
    assert err.count("Warning") == 1 and "NUMBA_CACHE_DIR" in err
    assert run(package, USE, cache=tmp_path / "given")[1] == ""  # the remedy


def test_a_full_disk_costs_a_warning(kept, monkeypatch) -> None:
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "write", full)

    @kernel
    def tripled(x):
        return 3 * x

    with pytest.warns(UserWarning, match="No space left.*NUMBA_CACHE_DIR"):
        assert tripled(2) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tripled(2.5) == 7.5


def test_division_by_zero_is_numpys(kept) -> None:
    @kernel
    def inverse(x):
        return 1.0 / x

    with told_to(lambda name: None):
        assert inverse(0.0) == np.inf


def test_an_error_in_a_kernel_leaves_no_lock(kept, monkeypatch) -> None:
    from numba.core.errors import TypingError

    @kernel
    def wrong(x):
        return x.no_such_thing

    dropped = []
    monkeypatch.setattr(LOCKS, "drop", dropped.append)
    with told_to(lambda name: None), pytest.raises(TypingError):
        wrong(1.0)
    name = f"{__name__}.test_an_error_in_a_kernel_leaves_no_lock.<locals>.wrong"
    assert dropped == [name]


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
def test_spawned_environments_on_a_fresh_installation(run, tmp_path) -> None:
    (tmp_path / "together.py").write_text(ENVIRONMENTS)
    cache = tmp_path / "cache"
    script = tmp_path / "together.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)}
    first = subprocess.run(
        [sys.executable, str(script)], env=environment, capture_output=True, text=True, timeout=600, check=True
    )
    assert first.stdout == "True True\n"
    said = first.stderr.splitlines()
    assert said[0] == progress.describe(0, 0.0) and said[-1].startswith("compiled "), first.stderr
    assert first.stderr.count(progress.describe(0, 0.0)) == 1
    assert all(read(file) is not None for file in cache.rglob("*.kernel"))
    # What two processes wrote at the same time can be read.
    assert run(tmp_path, ONE.replace("SCRIPTS", str(tmp_path)), cache=cache)[0] == ""


def test_where_compiling_is_forbidden_a_kernel_says_so_in_one_sentence(package, run, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    code = """
        from activestructure_gym.errors import InputError
        import tiny  # may be loaded
        try:
            tiny.doubled(2)
        except InputError as error:
            print(error)
    """
    out, err = run(package, code, cache=tmp_path / "cache")
    assert out.startswith("NUMBA_DISABLE_JIT is set") and out.endswith("Unset it") and err == ""


def test_a_comparison_and_the_doctor_say_that_compiling_is_forbidden(monkeypatch, capsys) -> None:
    from numba import config

    from activestructure_gym.evaluation.cli import main
    from activestructure_gym.evaluation.running.comparison import Comparison
    from activestructure_gym.sensors import renderer

    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    monkeypatch.setattr(renderer, "renderer_status", lambda: {"raycast": "works"})
    with pytest.raises(InputError, match="NUMBA_DISABLE_JIT is set"):
        Comparison(["box"], ["random"]).check_machine()
    assert main(["doctor"]) == 1
    assert "`asg compare` cannot run: kernels numba does not work" in " ".join(capsys.readouterr().out.split())
