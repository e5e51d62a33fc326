"""Compiling the kernels before the clock of any run starts, while the scenes are prepared.

``python -m activestructure_gym.evaluation.running.warmup`` is the process that does it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.cores import core_count
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.processes import UTF_8, end_session
from activestructure_gym.evaluation.machine.threads import worker_environment
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.engines.process import search_path
from activestructure_gym.evaluation.running.first_kernels import kernels_of, not_compiled

_MARK = "compiling"  # before the name of a kernel, on standard output
_COUNTS = ("NUMBA_NUM_THREADS",)  # variables of numba that change no machine code
_PATIENCE_S = 120.0  # without a new kernel, after which a policy or feature of others counts as one that never ends
_GRACE_S = 5.0  # between asking a process to stop and killing it
_FRAMES = 12  # enough for a few decisions, a path and two keyframes on it


@contextmanager
def warming_up(
    policies: Sequence[str], overrides: Mapping[str, Any], notify: Callable[[str], None] = lambda _: None
) -> Iterator[None]:
    """Run the smallest possible job in another process while the block runs, and wait for it at the end.

    Then every feature that the policies ask for is evaluated there.

    Compiled kernels are kept on disk, so the first run of a comparison need not compile again, and no run's time
    contains a compilation. Half of the compiling is the rasteriser's: it gets a process of its own. Results are
    thrown away, and so are failures: a real job that fails will say why. ``notify`` hears how far the compiling is, in
    this process too; nothing where all is compiled. Where the same warm-up has come to its end before, there is
    nothing to do (`WarmMark`).
    """
    from activestructure_gym.compiling import told_to

    smallest, gains = smallest_job(policies, overrides), all_gains(policies)
    mark = WarmMark.of(smallest, gains)
    if mark is not None and mark.holds():
        yield
        return
    work = json.dumps({"job": smallest.as_dict(), "gains": gains})
    tally = _Tally(notify, not_compiled(kernels_of(gains), kernel_files()))
    processes = [_start(part, work, tally) for part in ("map", "world")]
    try:
        with told_to(tally):
            yield
        ended = [_wait(process, tally) for process in processes]
        tally.conclude()
        if mark is not None and not any(ended):
            mark.leave()
    finally:
        for process in processes:
            _end(process)


def _wait(process: subprocess.Popen[str], tally: _Tally) -> int:
    """The exit code of a process; 1 where it goes on without compiling anything."""
    began = time.monotonic()
    while True:
        try:
            return process.wait(1.0)
        except subprocess.TimeoutExpired:
            if time.monotonic() - max(began, tally.heard) > _PATIENCE_S:
                return 1


def _end(process: subprocess.Popen[str]) -> None:
    """End a process and what it has started."""
    process.terminate()
    try:
        process.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    end_session(process.pid)


@dataclass(frozen=True)
class WarmMark:
    """A note beside the compiled kernels that a warm-up has come to its end, which takes seconds to find out anew.

    It holds as long as no source file, no version and no setting that kernels depend on has changed, and as long as
    every file of compiled kernels that was there then is there now.
    """

    path: Path
    digest: str

    @classmethod
    def of(cls, job: Job, gains: Sequence[str] = ()) -> WarmMark | None:
        """The mark of this job and these features; None where kernels cannot be kept or are not this package's."""
        from activestructure_gym.compiling import cache_place
        from activestructure_gym.features import FEATURES
        from activestructure_gym.policies import make_policy

        ours = f"{__name__.partition('.')[0]}."
        origins = [type(make_policy(job.policy)), *(FEATURES.get(FEATURES.owner(name)) for name in gains)]
        if not all(origin.__module__.startswith(ours) for origin in origins):
            return None
        if ":" in str(job.overrides):
            return None
        place = cache_place()
        if place is None:
            return None
        content = [job.as_dict(), list(gains), _compiler(), _sources()]
        content.append(sorted((k, v) for k, v in os.environ.items() if k.startswith("NUMBA_") and k not in _COUNTS))
        name = _hashed([job.hash, list(gains)])[:12]
        return cls(place / f"activestructure_gym-warm-{name}.json", _hashed(content))

    def holds(self) -> bool:
        """Whether nothing needs to be compiled."""
        try:
            noted = json.loads(self.path.read_text(encoding="utf-8"))
            return noted["digest"] == self.digest and self._kept() >= set(noted["kernels"])
        except (OSError, ValueError, KeyError, TypeError):
            return False

    def leave(self) -> None:
        """Remember that everything is compiled."""
        kernels = sorted(self._kept())
        if kernels:
            with suppress(OSError):
                store.write_json(self.path, {"digest": self.digest, "kernels": kernels})

    def _kept(self) -> set[str]:
        """The files of compiled kernels that are not damaged."""
        from activestructure_gym.compiling.files import is_whole

        return {str(file) for file in kernel_files() if is_whole(file)}


def kernel_files() -> list[Path]:
    """All files of compiled kernels of this installation, damaged or not."""
    from activestructure_gym.compiling import cache_place
    from activestructure_gym.compiling.files import SUFFIX

    place = cache_place()
    if place is None:
        return []
    roots = _rooms() if place.name == "__pycache__" else [place.parent]  # beside the sources or all in one place
    return [file for root in roots for file in root.rglob(f"*{SUFFIX}")]


def _rooms() -> list[Path]:
    """The folders of this package; in a checkout some lie beside it."""
    package = __name__.partition(".")[0]
    found = [importlib.util.find_spec(f"{package}{room}") for room in ("", ".envs", ".policies", ".evaluation")]
    return [Path(next(iter(spec.submodule_search_locations or ()))) for spec in found if spec is not None]


def _sources() -> list[tuple[str, int, int]]:
    """Modification time and size of every source file."""
    files = {file for room in _rooms() for file in room.rglob("*.py")}
    return sorted((str(file), (about := file.stat()).st_mtime_ns, about.st_size) for file in files)


def _compiler() -> list[str]:
    """Versions of the compiler, and the processor it compiles for."""
    from llvmlite import binding

    versions = [sys.version, *(metadata.version(name) for name in ("numba", "llvmlite", "numpy"))]
    return [*versions, binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()]


def _hashed(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


class _Tally:
    """Puts together what several processes compile; each kernel counts once.

    ``expected`` names what has to be compiled. A kernel that it lacks, as of a feature of the user's own, is added.
    """

    def __init__(self, notify: Callable[[str], None], expected: Collection[str] = ()) -> None:
        self._notify = notify
        self._names: set[str] = set()
        self._expected = set(expected)
        self._began = self.heard = time.monotonic()  # of the last kernel
        self._lock = threading.Lock()

    def __call__(self, name: str) -> None:
        from activestructure_gym.compiling.progress import begin, describe

        with self._lock:
            if not self._names:
                self._notify(begin())
            self._names.add(name)
            self.heard = time.monotonic()
            total = len(self._expected | self._names) if self._expected else None
            self._notify(describe(len(self._names), self._seconds(), total))

    def conclude(self) -> None:
        """Report that all is compiled, if anything had to be."""
        from activestructure_gym.compiling.progress import conclusion

        with self._lock:
            if self._names:
                self._notify(conclusion(len(self._names), self._seconds()))

    def _seconds(self) -> float:
        return time.monotonic() - self._began


def _start(part: str, work: str, tally: Callable[[str], None]) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "activestructure_gym.evaluation.running.warmup", part],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # It must compile what the workers will use, so it finds everything where they do.
        env=worker_environment(slots=core_count()) | UTF_8 | {"PYTHONPATH": os.pathsep.join(search_path())},
        text=True,
        encoding="utf-8",
        start_new_session=True,  # Ctrl-C reaches it through us
    )
    assert process.stdin is not None
    threading.Thread(target=_listen, args=(process, tally), daemon=True).start()
    try:
        process.stdin.write(work + "\n")
        process.stdin.close()
    except BrokenPipeError:
        pass  # it died at once
    return process


def _listen(process: subprocess.Popen[str], tally: Callable[[str], None]) -> None:
    assert process.stdout is not None
    with process.stdout as lines:
        for line in lines:
            mark, _, name = line.strip().partition(" ")
            if mark == _MARK:
                tally(name)


def smallest_job(policies: Sequence[str], overrides: Mapping[str, Any]) -> Job:
    """A few frames in the box room with small images, for the policy that asks for the most features."""
    from activestructure_gym.policies import make_policy

    return Job(
        scene="box",
        policy=max(policies, key=lambda name: len(make_policy(name).required_gains)),
        seed=0,
        preset="fast",
        frame_budget=_FRAMES,
        overrides=tuple(overrides.items()),
        protocol=dataclasses.replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000),
    )


def all_gains(policies: Sequence[str]) -> list[str]:
    """The features that any of the policies asks for."""
    from activestructure_gym.policies import make_policy

    return sorted({gain for name in policies for gain in make_policy(name).required_gains})


def main(part: str) -> None:
    """Compile the kernels of the map, or all others and then what the job and features on standard input need.

    Standard output says which kernel is compiled, one per line.
    """
    from activestructure_gym.compile_ahead import compile_map, compile_motion, compile_sensing, compile_views
    from activestructure_gym.compiling import told_to
    from activestructure_gym.evaluation.protocols.activegamer import masked
    from activestructure_gym.evaluation.running.episode import run_job

    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # so that the directory is removed
    work = json.loads(sys.stdin.readline())
    job = Job.from_dict(work["job"])
    with told_to(lambda name: print(_MARK, name, flush=True)):
        if part == "map":
            compile_map()
            # The job below is measured by one protocol only.
            image, depth = np.zeros((1, 1, 3)), np.zeros((1, 1), np.float32)
            masked(image.astype(np.float32), image.astype(np.uint8), depth, depth)
            return
        compile_sensing()
        compile_motion()
        compile_views()
        with tempfile.TemporaryDirectory(prefix="asg-warm-up-") as directory:
            run_job(job, Path(directory) / "run")
        _evaluate(work["gains"], job)


def _evaluate(gains: Sequence[str], job: Job) -> None:
    """Evaluate all features at two decisions under the job's configuration."""
    from activestructure_gym.envs import ReconstructionEnv

    env = ReconstructionEnv(scene=job.scene, preset=job.preset, gains=gains, config=dict(job.overrides))
    env.reset(seed=job.seed)
    env.step(0)
    env.close()


if __name__ == "__main__":
    main(sys.argv[1])
