"""Jobs on the machines of a Ray cluster; all of them see the comparison's directory under the same path.

A Ray task starts the same worker process as engine ``local`` and waits for it. So the caps on threads are set before
any library loads, a job that crashes takes no Ray worker with it, and results are written in the same way. Ray runs a
task again when it loses the worker or the machine; the process of a lost task ends
by itself, because its standard input does.
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
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import is_done
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

_LOSSES = 3  # workers or machines that may be lost during one job before it is given up: Ray's own default
_TICK = 0.25  # seconds between two looks at the progress
_PATIENCE = 10.0  # seconds until a file written on one machine is seen on another, where the file system is shared


def run_ray(
    jobs: Sequence[Job],
    directory: Path,
    listener: Listener,
    limits: Limits,
    *,
    keep_open: Sequence[int] = (),  # of no use to other machines
    command: Sequence[str] = WORKER,  # what the interpreter runs, before the run directory
) -> list[Outcome]:
    """Run all jobs, each in a process of its own on some machine of the cluster.

    The cluster is the one of ``RAY_ADDRESS``, else one that ``ray start`` has started on this machine, else this
    machine alone. ``limits.timeout_min`` and ``limits.retries`` are those of engine ``local``; a lost Ray worker or
    machine is Ray's to replace, and counts as no attempt. Raises `InputError` where the cluster cannot be reached.
    """
    (directory / LOGS).mkdir(parents=True, exist_ok=True)
    ours, ray = _connect()
    threads = _threads(len(jobs), limits)
    board: Any = ray.remote(num_cpus=0)(_Board).options(scheduling_strategy=_here(ray)).remote()
    news = _News(ray, board)
    task: Any = ray.remote(num_cpus=threads, max_retries=max(_LOSSES, limits.retries))(_attempt)
    variables = {name: value for name, value in os.environ.items() if name.startswith("ASG_")}
    variables["PYTHONPATH"] = os.pathsep.join(search_path())
    waiting = [(job, 1) for job in reversed(jobs)]  # and which attempt it is
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
            lines = news.lines()
            if ready:  # what these said is on the board, and may have come after the first question
                lines += news.lines(_PATIENCE)
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
    """Arguments of a Ray task."""

    job: dict[str, Any]
    directory: str
    command: tuple[str, ...]
    variables: Mapping[str, str]
    threads: int
    minutes: float
    attempt: int


class _Board:
    """An actor that keeps what the workers say until the supervisor asks for it."""

    def __init__(self) -> None:
        self._lines: list[tuple[str, str]] = []

    def tell(self, name: str, line: str) -> None:
        self._lines.append((name, line))

    def take(self) -> list[tuple[str, str]]:
        lines, self._lines = self._lines, []
        return lines


def _attempt(order: _Order, board: Any) -> Ended:
    """One attempt at a job, on whichever machine this runs."""
    job, directory = Job.from_dict(order.job), Path(order.directory)
    if not directory.is_dir():
        return Ended(f"'{directory}' is not on every machine of the cluster; choose an --out that all of them share")
    # This may be Ray's second attempt, after the first one had written its result.
    if is_done(run_directory(directory, job), job):
        return Ended()
    messages: Messages = queue.SimpleQueue()
    told: list[Any] = []
    worker = WorkerProcess(
        job, directory, messages, environment=capped_environment(order.threads) | dict(order.variables),
        command=order.command, minutes=order.minutes, attempt=order.attempt,
    )  # fmt: skip
    try:
        while True:
            name, line = next_message(messages, [worker])
            if line is None:
                ended = worker.finish()
                _await_all(told)
                return ended
            told = [board.tell.remote(name, line)]  # an actor hears what one caller says in order: the last is enough
    except BaseException:
        worker.ask_to_stop()
        worker.stop()
        raise


def _await_all(told: list[Any]) -> None:
    """Wait until the board has heard this; without a board nobody listens."""
    import ray

    if told:
        ray.wait(told, timeout=_PATIENCE)


def _result(ray: Any, reference: Any, job: Job, directory: Path) -> Ended:
    """The outcome of a Ray task, as this machine sees it."""
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
            os.listdir(place.parent)  # a network file system looks again
    return ended


class _News:
    """Polls the board for messages, one request at a time: an answer may be late, and messages leave with it."""

    def __init__(self, ray: Any, board: Any) -> None:
        self._ray, self._board = ray, board
        self._asked: Any = None

    def lines(self, patience: float = 10 * _TICK) -> list[tuple[str, str]]:
        """The lines since the last answer; none if it takes longer than ``patience`` seconds or there is no board."""
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
    """Ray itself, connected, and whether it is ours to shut down."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # what Ray will do anyway, without its warning
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
    """Show clusters the user's token; if there is none, one for a cluster that lives no longer than this process.

    Ray by itself shows no token where ``RAY_ADDRESS`` is given. And it writes one to the home directory when it starts
    a cluster of its own: from then on ``ray start --head`` would ask for it while ``ray start --address`` does not show
    it, so that a run on one machine would break the recipe for many. A cluster that asks for no token takes any.
    """
    if "RAY_AUTH_MODE" in os.environ or "ray" in sys.modules:  # Ray reads the mode when it is imported
        return
    os.environ["RAY_AUTH_MODE"] = "token"
    files = (os.environ.get("RAY_AUTH_TOKEN_PATH"), os.path.expanduser("~/.ray/auth_token"))
    if not os.environ.get("RAY_AUTH_TOKEN") and not any(file and os.path.isfile(file) for file in files):
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)


def _here(ray: Any) -> Any:
    """Scheduling strategy: on this machine if possible, so that the loss of another one costs nothing."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)


def _threads(jobs: int, limits: Limits) -> int:
    """Threads of each job: the cluster's cores shared out evenly, never more than its smallest machine has."""
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
