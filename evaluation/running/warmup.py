"""Compile the kernels of a comparison before the clock of any run starts, while the scenes are prepared."""

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

_COUNTS = ("NUMBA_NUM_THREADS",)  # variables of numba that change no machine code
_FRAMES = 12  # enough for a few decisions, a path and two keyframes on it


@contextmanager
def warming_up(
    policies: Sequence[str], overrides: Mapping[str, Any], notify: Callable[[str], None] = lambda _: None
) -> Iterator[None]:
    """Play the smallest possible job in another process while the block runs, and wait for it at the end.

    That process then evaluates every feature that the policies need. A second one compiles the map's kernels, which
    take half of the time. So no run's time contains a compilation. Results are discarded, and so are failures: the real
    job will fail with a reason. ``notify`` gets the progress, nothing if all is compiled. Where the same warm-up
    succeeded before, nothing is started.
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
    world = [f"{FIRST_USE}:{part}" for part in ("sensing", "motion", "views")]
    work = json.dumps({"job": smallest.as_dict(), "features": features})
    calls = [[f"{__name__}:compile_map"], [*world, f"{__name__}:play {work}"]]
    with told_to(tally), compiling_beside(calls, tally, worker_environment(slots=core_count())) as succeeded:
        yield
    tally.conclude()
    if marker is not None and all(succeeded):
        with suppress(OSError), replaced(marker) as file:
            file.write("\n".join(map(str, kernel_files())).encode())


def is_current(marker: Path) -> bool:
    """Return whether the marker is there, and all cache files of kernels that it lists are there and undamaged."""
    from activestructure_gym.compiling.files import is_whole

    try:
        listed = marker.read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):
        return False
    return all(is_whole(Path(file)) for file in listed)


def completion_marker(job: Job, features: Sequence[str] = ()) -> Path | None:
    """Return the file that says that this warm-up has succeeded; None if it is always made.

    Its name depends on the job, the features, all source files, the versions and the settings of the compiler. There is
    none where no cache file can be kept or code of the user takes part.
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
    """Count the kernels that several processes compile, each once, and report the progress.

    ``expected`` names the kernels to compile. Others, of a feature of the user for example, are added to the total.
    """

    def __init__(self, notify: Callable[[str], None], expected: Collection[str] = ()) -> None:
        self._notify = notify
        self._names: set[str] = set()
        self._expected = set(expected)
        self._began = time.monotonic()
        self._lock = threading.Lock()

    def __call__(self, name: str) -> None:
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
    """Return a few frames in the box room with small images, for the policy that needs the most features."""
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
    """Return the features that any of the policies needs."""
    from activestructure_gym.policies import make_policy

    return sorted({feature for name in policies for feature in make_policy(name).required_features})


def compile_map() -> None:
    """Call the kernels of the map, and those of the protocol that does not measure the smallest job."""
    from activestructure_gym.evaluation.protocols.activegamer import masked
    from activestructure_gym.first_use import map_making

    map_making()
    image, depth = np.zeros((1, 1, 3)), np.zeros((1, 1), np.float32)
    masked(image.astype(np.float32), image.astype(np.uint8), depth, depth)


def play(work: Mapping[str, Any]) -> None:
    """Run the job of ``work``, then evaluate its features at two decisions under the job's configuration."""
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
