"""Compile the kernels of a comparison while its scenes are prepared, so that no run's time includes compilation."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.cores import core_count
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.threads import worker_environment
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.first_kernels import kernels_of, not_compiled

_COUNTS = ("NUMBA_NUM_THREADS",)  # variables of numba that do not change the machine code
_FRAMES = 12  # enough for a few decisions and a path with two keyframes


@contextmanager
def warming_up(
    policies: Sequence[str], overrides: Mapping[str, Any], notify: Callable[[str], None] = lambda _: None
) -> Iterator[None]:
    """Compile all kernels in two other processes while the block runs, and wait for them at the end.

    One process plays the smallest possible job and then evaluates every feature that the policies need. The other one
    compiles the map's kernels, which take half of the time. Results and failures are ignored: the real job will fail
    with a message. ``notify`` is called with the progress if anything is compiled. If the same warm-up has succeeded
    before, nothing is started.
    """
    from activestructure_gym.compiling import told_to
    from activestructure_gym.compiling.ahead import FIRST_USE, compiling_beside
    from activestructure_gym.compiling.files import kernel_files
    from activestructure_gym.files import replaced

    smallest, features = smallest_job(policies, overrides), all_features(policies)
    marker = completion_marker(smallest, features)
    if marker is not None and is_current(marker):
        yield
        return
    tally = Tally(notify, not_compiled(kernels_of(features), kernel_files()))
    world = [f"{FIRST_USE}:{room}" for room in ("sensing", "motion", "views")]
    work = json.dumps({"job": smallest.as_dict(), "features": features})
    calls = [[f"{__name__}:compile_map"], [*world, f"{__name__}:play {work}"]]
    with told_to(tally), compiling_beside(calls, tally, worker_environment(slots=core_count())) as succeeded:
        yield
    tally.conclude()
    if marker is not None and all(succeeded):
        with suppress(OSError), replaced(marker) as file:
            file.write("\n".join(map(str, kernel_files())).encode())


def is_current(marker: Path) -> bool:
    """Return whether the completion marker exists and all compiled kernels that it lists are undamaged."""
    from activestructure_gym.compiling.files import is_whole

    try:
        listed = marker.read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):
        return False
    return all(is_whole(Path(file)) for file in listed)


def completion_marker(job: Job, features: Sequence[str] = ()) -> Path | None:
    """Return the path of the marker file of a successful warm-up, None if this warm-up is always repeated.

    The file name depends on the job, the features, all source files, and the versions and settings of the compiler.
    There is no marker if compiled kernels cannot be stored, or if plug-in code is used.
    """
    from llvmlite import binding

    from activestructure_gym.compiling.files import cache_place, package_folders
    from activestructure_gym.features import FEATURES
    from activestructure_gym.policies import make_policy

    origins = [type(make_policy(job.policy)), *(FEATURES.get(FEATURES.owner(name)) for name in features)]
    ours = all(origin.__module__.startswith("activestructure_gym.") for origin in origins)
    place = cache_place()
    if not ours or ":" in str(job.conditions.overrides) or place is None:
        return None
    sources = {file for folder in package_folders() for file in folder.rglob("*.py")}
    content = [
        job.as_dict(), list(features), sorted((str(file), file.stat().st_mtime_ns) for file in sources),
        sys.version, *(metadata.version(name) for name in ("numba", "llvmlite", "numpy")),
        binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten(),
        sorted((name, os.environ[name]) for name in os.environ if name.startswith("NUMBA_") and name not in _COUNTS),
    ]  # fmt: skip
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    return place / f"activestructure_gym-{digest[:16]}.warm"


class Tally:
    """Count the kernels that several processes compile, each name once, and report the progress.

    ``expected`` holds the names of the kernels to compile. Others, for example of a plug-in feature, are added to the
    total.
    """

    def __init__(self, notify: Callable[[str], None], expected: Collection[str] = ()) -> None:
        self._notify = notify
        self._names: set[str] = set()
        self._expected = set(expected)
        self._began = time.monotonic()
        self._lock = threading.Lock()

    def __call__(self, name: str) -> None:
        """Count one compiled kernel and report the progress."""
        from activestructure_gym.compiling.progress import begin, describe

        with self._lock:
            if not self._names:
                self._notify(begin())
            self._names.add(name)
            total = len(self._expected | self._names) if self._expected else None
            self._notify(describe(len(self._names), time.monotonic() - self._began, total))

    def conclude(self) -> None:
        """Report the end, if anything was compiled."""
        from activestructure_gym.compiling.progress import conclusion

        if self._names:
            self._notify(conclusion(len(self._names), time.monotonic() - self._began))


def smallest_job(policies: Sequence[str], overrides: Mapping[str, Any]) -> Job:
    """Return a job of a few frames and small images in the box room, with the policy that needs the most features."""
    from activestructure_gym.policies import make_policy

    return Job(
        scene="box",
        policy=max(policies, key=lambda name: len(make_policy(name).required_features)),
        seed=0,
        conditions=Conditions(
            preset="fast",
            frame_budget=_FRAMES,
            overrides=overrides,
            protocol=StandardProtocol(views=1, view_width=64, view_height=36, surface_samples=2000),
        ),
    )


def all_features(policies: Sequence[str]) -> list[str]:
    """Return the features that at least one of the policies needs, sorted."""
    from activestructure_gym.policies import make_policy

    return sorted({feature for name in policies for feature in make_policy(name).required_features})


def compile_map() -> None:
    """Call the kernels of the map, and those of the protocol `ActiveGamerProtocol`, which the smallest job lacks."""
    from activestructure_gym.evaluation.protocols.activegamer import masked
    from activestructure_gym.first_use import map_making

    map_making()
    image, depth = np.zeros((1, 1, 3)), np.zeros((1, 1), np.float32)
    masked(image.astype(np.float32), image.astype(np.uint8), depth, depth)


def play(work: Mapping[str, Any]) -> None:
    """Run the job of ``work``, then evaluate its features at two decisions with the job's configuration."""
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.evaluation.running.episode import run_job

    job = Job.from_dict(work["job"])
    with tempfile.TemporaryDirectory(prefix="asg-warm-up-") as directory:
        run_job(job, Path(directory) / "run")
    env = ReconstructionEnv(
        scene=job.scene, preset=job.conditions.preset, features=work["features"], config=dict(job.conditions.overrides)
    )
    env.reset(seed=job.seed)
    env.step(0)
    env.close()
