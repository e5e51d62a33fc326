"""Compiling the kernels before the clock of any run starts, while this process prepares the scenes."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from activestructure_gym.evaluation.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.threads import worker_environment

_FRAMES = 12  # enough for a few decisions, a path and two keyframes on it


@contextmanager
def warming_up(policies: Sequence[str], overrides: Mapping[str, Any]) -> Iterator[None]:
    """Run the smallest possible job in another process while the block runs, and wait for it at the end.

    numba keeps what it compiles on disk, so the first run of a comparison need not compile again, and no run's time
    contains a compilation. Costs nothing where the second core would be idle. Its result is thrown away, and so is
    its failure: a real job that fails will say why.
    """
    with tempfile.TemporaryDirectory(prefix="asg-warm-up-") as directory:
        process = subprocess.Popen(
            [sys.executable, "-m", "activestructure_gym.evaluation.worker", str(Path(directory) / "run")],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=worker_environment(slots=2),
            text=True,
            start_new_session=True,  # Ctrl-C reaches it through us
        )
        try:
            assert process.stdin is not None
            process.stdin.write(json.dumps(smallest_job(policies, overrides).as_dict()) + "\n")
            process.stdin.flush()
            yield
            process.wait()
        except BrokenPipeError:
            pass
        finally:
            process.terminate()
            process.wait()


def smallest_job(policies: Sequence[str], overrides: Mapping[str, Any]) -> Job:
    """A few frames in the box room with small images, for the policy that asks for the most gains."""
    from activestructure_gym.policies import POLICIES

    return Job(
        scene="box",
        policy=max(policies, key=lambda name: len(POLICIES.get(name).required_gains)),
        seed=0,
        preset="fast",
        frame_budget=_FRAMES,
        overrides=tuple(overrides.items()),
        protocol=dataclasses.replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000),
    )
