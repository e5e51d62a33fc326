"""Run jobs on the machines of a Ray cluster, which share the comparison's directory under the same path.

A Ray task starts the same worker process as engine ``local`` and waits for it. So thread limits are set before any
library is loaded, a crash of a job does not end the Ray worker, and results are written in the same way. Ray repeats a
task when its worker or machine is lost. The process of a lost task ends because its standard input is closed.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import queue
import secrets
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.comparison import run_directory
from activestructure_gym.evaluation.archive.completion import is_done
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.machine.threads import capped_environment
from activestructure_gym.evaluation.running.engines.base import LOGS, Engine, Limits, Listener, Outcome
from activestructure_gym.evaluation.running.engines.process import (
    WORKER,
    Ended,
    Messages,
    WorkerProcess,
    next_message,
    read_progress,
    search_path,
)

_LOSSES = 3  # lost workers or machines per job before it fails: Ray's default
_TICK = 0.25  # seconds between two requests for progress
_PATIENCE = 10.0  # seconds until a file written on one machine is visible on another through the shared file system


def run_ray(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    limits: Limits,
    *,
    keep_open: Sequence[int] = (),  # ignored: descriptors cannot be passed to other machines
    command: Sequence[str] = WORKER,  # arguments of the interpreter before the run directory
) -> list[Outcome]:
    """Run all jobs, each in a process of its own on a machine of the cluster.

    The cluster is that of ``RAY_ADDRESS``, else one started on this machine by ``ray start``, else this machine alone.
    ``limits.timeout_min`` and ``limits.retries`` have the same meaning as for engine ``local``. A lost Ray worker or
    machine is replaced by Ray and does not count as an attempt. Raise `InputError` if the cluster cannot be reached.
    """
    (directory / LOGS).mkdir(parents=True, exist_ok=True)
    ours, ray = _connect()
    threads = _threads(len(jobs), limits)
    board: Any = ray.remote(num_cpus=0)(_Board).options(scheduling_strategy=_here(ray)).remote()
    reader = _BoardReader(ray, board)
    task: Any = ray.remote(num_cpus=threads, max_retries=max(_LOSSES, limits.retries))(_attempt)
    variables = {name: value for name, value in os.environ.items() if name.startswith("ASG_")}
    variables["PYTHONPATH"] = os.pathsep.join(search_path())
    waiting = [(job, 1) for job in reversed(jobs)]  # (job, number of the attempt)
    running = dict[Any, tuple[Job, int]]()
    outcomes = list[Outcome]()
    try:
        while waiting or running:
            while waiting and len(running) < (limits.workers or len(jobs)):
                job, attempt = waiting.pop()
                order = _Order(
                    job.as_dict(),
                    str(directory.resolve()),
                    tuple(command),
                    variables,
                    threads,
                    limits.timeout_min,
                    attempt,
                )
                running[task.remote(order, board)] = job, attempt
            ready, _ = ray.wait(list(running), timeout=_TICK)
            lines = reader.lines()
            if ready:  # the last lines of ended jobs may have reached the board after the first request
                lines += reader.lines(_PATIENCE)
            _pass_on(lines, {job.name: job for job, _ in running.values()}, listener)
            for reference in ready:
                job, attempt = running.pop(reference)
                ended = _result(ray, reference, job, directory)
                if ended.lost and attempt <= limits.retries:
                    listener.on_retry(job, ended.error or "")
                    waiting.insert(0, (job, attempt + 1))
                    continue
                outcomes.append(Outcome(job, ended.error, attempt))
                listener.ended(outcomes[-1])
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        if ours:
            ray.shutdown()
        else:
            ray.kill(board)
    return outcomes


@dataclass(frozen=True)
class _Order:
    """Hold the arguments of a Ray task."""

    job: dict[str, Any]
    directory: str
    command: tuple[str, ...]
    variables: Mapping[str, str]
    threads: int
    minutes: float
    attempt: int


class _Board:
    """Collect the output lines of the workers, as a Ray actor, until the supervisor requests them."""

    def __init__(self) -> None:
        self._lines: list[tuple[str, str]] = []

    def add(self, name: str, line: str) -> None:
        """Add a line of the named job."""
        self._lines.append((name, line))

    def take(self) -> list[tuple[str, str]]:
        """Return all lines since the last call, with the names of their jobs."""
        lines, self._lines = self._lines, []
        return lines


def _attempt(order: _Order, board: Any) -> Ended:
    """Run one attempt at a job on the machine of this task."""
    job, directory = Job.from_dict(order.job), Path(order.directory)
    if not directory.is_dir():
        return Ended(f"'{directory}' is not on every machine of the cluster; choose an --out that all of them share")
    # Ray may repeat a task after its first execution has written the result.
    if is_done(run_directory(directory, job), job):
        return Ended()
    messages: Messages = queue.SimpleQueue()
    sent: list[Any] = []
    worker = WorkerProcess(
        job, directory, messages, environment=capped_environment(order.threads) | dict(order.variables),
        command=order.command, minutes=order.minutes, attempt=order.attempt,
    )  # fmt: skip
    try:
        while True:
            name, line = next_message(messages, [worker])
            if line is None:
                ended = worker.finish()
                _await_all(sent)
                return ended
            sent = [board.add.remote(name, line)]  # calls of one caller run in order, so only the last is awaited
    except BaseException:
        worker.ask_to_stop()
        worker.stop()
        raise


def _await_all(sent: list[Any]) -> None:
    """Wait until the board has received the lines, or `_PATIENCE` has passed."""
    import ray

    if sent:
        ray.wait(sent, timeout=_PATIENCE)


def _result(ray: Any, reference: Any, job: Job, directory: Path) -> Ended:
    """Return the result of a Ray task; wait until its files are visible on this machine."""
    try:
        ended: Ended = ray.get(reference)
    except ray.exceptions.RayError as error:
        return Ended(f"lost by the cluster: {str(error).strip().splitlines()[0]} ({type(error).__name__})")
    place = run_directory(directory, job)
    waited = time.monotonic()
    while ended.error is None and not is_done(place, job):
        if time.monotonic() - waited > _PATIENCE:
            return Ended("finished on another machine, and not seen here; choose an --out that all machines share")
        time.sleep(_TICK)
        if place.parent.is_dir():
            os.listdir(place.parent)  # makes a network file system update its cache
    return ended


class _BoardReader:
    """Request lines from the board, one request at a time: the board deletes the lines that it returns."""

    def __init__(self, ray: Any, board: Any) -> None:
        self._ray, self._board = ray, board
        self._asked: Any = None

    def lines(self, patience: float = 10 * _TICK) -> list[tuple[str, str]]:
        """Return the lines since the last answer; none if it takes over ``patience`` seconds or the board fails."""
        if self._asked is None:
            self._asked = self._board.take.remote()
        if not self._ray.wait([self._asked], timeout=patience)[0]:
            return []
        asked, self._asked = self._asked, None
        try:
            lines: list[tuple[str, str]] = self._ray.get(asked)
        except self._ray.exceptions.RayError:
            return []
        return lines


def _pass_on(lines: Sequence[tuple[str, str]], jobs: Mapping[str, Job], listener: Listener) -> None:
    for name, line in lines:
        progress = read_progress(line)
        if progress and name in jobs:
            listener.progress(jobs[name], progress)


def _connect() -> tuple[bool, Any]:
    """Connect to a cluster; return whether this call started the connection, and the module ``ray``."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # Ray's future default; avoids its warning
    _choose_token()
    import ray

    if ray.is_initialized():
        return False, ray
    try:
        ray.init(include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        address = os.environ.get("RAY_ADDRESS", "")
        where = f"the Ray cluster at RAY_ADDRESS={address}" if address else "the Ray cluster of this machine"
        reason = str(getattr(error, "message", error)).strip().splitlines()[0]
        if address or isinstance(error, ray.exceptions.AuthenticationError):
            reason += "; if it asks for a token, set RAY_AUTH_TOKEN to what `ray get-auth-token` prints on its head"
        raise InputError(f"{where} cannot be reached: {reason}") from error
    return True, ray


def _choose_token() -> None:
    """Make Ray use the user's token; without one, create a token for this process only.

    By default Ray sends no token if ``RAY_ADDRESS`` is set. When it starts a cluster itself, it writes a token to the
    home directory. From then on ``ray start --head`` requires the token, but ``ray start --address`` does not send it.
    So a run on one machine would break later runs on several. A cluster without tokens accepts any token.
    """
    if "RAY_AUTH_MODE" in os.environ or "ray" in sys.modules:  # Ray reads the mode when it is imported
        return
    os.environ["RAY_AUTH_MODE"] = "token"
    files = (os.environ.get("RAY_AUTH_TOKEN_PATH"), os.path.expanduser("~/.ray/auth_token"))
    if not os.environ.get("RAY_AUTH_TOKEN") and not any(file and os.path.isfile(file) for file in files):
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)


def _here(ray: Any) -> Any:
    """Return a scheduling strategy that prefers this machine, so that the board survives the loss of another one."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)


def _threads(jobs: int, limits: Limits) -> int:
    """Return the threads per job: an equal share of the cluster's cores, at most the cores of its smallest machine."""
    import ray

    machines = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
    machines = [cores for cores in machines if cores] or [1]
    return max(1, min(min(machines), sum(machines) // max(1, min(jobs, limits.workers or jobs))))


def _slots(jobs: int, limits: Limits) -> int:
    _, ray = _connect()
    cores = int(ray.cluster_resources().get("CPU", 1))
    return max(1, min(jobs, limits.workers or jobs, cores // _threads(jobs, limits)))


def _check(limits: Limits) -> None:
    if importlib.util.find_spec("ray") is None:
        raise InputError("engine 'ray' needs the package ray: pip install 'activestructure-gym[ray]'")


ENGINE = Engine(run_ray, slots=_slots, check=_check)
