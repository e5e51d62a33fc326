"""Run one job as a worker process of an engine: ``python -m`` this module with the run directory.

The worker reads the job as one line of JSON from standard input. It writes its progress as JSON lines to standard
output and all other text to standard error. It ends when its standard input is closed, so it never outlives its
supervisor; then it also ends the processes of its session. Further arguments are file descriptors that the worker keeps
open and closes in the processes that it forks.
"""

from __future__ import annotations

import dataclasses
import faulthandler
import json
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import IO, NoReturn

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.processes import end_session
from activestructure_gym.evaluation.machine.threads import thread_cap

_GRACE_SECONDS = 5.0  # time for the main thread to clean up before the process is ended
_PATIENCE_SECONDS = 30.0  # time for threads and exit handlers of other code to end after the run


class _Terminated(SystemExit):
    """Signal that this process was asked to end."""


def main() -> int:
    """Run the job from standard input; return 0 if its directory is written."""
    faulthandler.enable()
    signal.signal(signal.SIGTERM, _unwind)
    job_line = sys.stdin.readline()
    if not job_line:
        print("no job on standard input", file=sys.stderr)
        return 2
    # Progress uses the original standard output; output of policies is redirected to standard error.
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    _keep_from_children([channel.fileno(), *map(int, sys.argv[2:])])
    threading.Thread(target=_follow_supervisor, daemon=True).start()

    import cv2

    from activestructure_gym.evaluation.archive.jobs import Job
    from activestructure_gym.evaluation.running.episode import run_job

    cv2.setNumThreads(thread_cap())
    job = Job.from_dict(json.loads(job_line))
    try:
        run_job(job, Path(sys.argv[1]), lambda progress: _send(channel, dataclasses.asdict(progress)))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except _Terminated:
        raise
    except SystemExit:  # raised by a policy, a feature or a scene
        traceback.print_exc()
        raise
    return 0


def end_after(work: Callable[[], int]) -> NoReturn:
    """End this process with the exit code of ``work``, even if threads or exit handlers of other code never end."""
    code = 1
    try:
        code = work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
    finally:
        threading.Thread(target=_end_late, args=(code,), daemon=True).start()
    sys.exit(code)


def _end_late(code: int) -> None:
    time.sleep(_PATIENCE_SECONDS)
    others = [thread.name for thread in threading.enumerate() if not thread.daemon and thread.name != "MainThread"]
    who = f"threads of it have not ended: {', '.join(others)}" if others else "its exit handlers have not returned"
    print(f"this process is ended {_PATIENCE_SECONDS:g} s after its run, since {who}", file=sys.stderr, flush=True)
    os._exit(code)


def _keep_from_children(descriptors: Sequence[int]) -> None:
    """Close the file descriptors of the progress and of the directory's lock in processes that a policy starts."""
    for descriptor in descriptors:
        os.set_inheritable(descriptor, False)

    def replace() -> None:
        null = os.open(os.devnull, os.O_RDWR)
        for descriptor in descriptors:
            os.dup2(null, descriptor, inheritable=False)  # a closed number would be reused by the next open file
        os.close(null)

    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=replace)


def _send(channel: IO[str], content: dict[str, object]) -> None:
    channel.write(json.dumps(content) + "\n")
    channel.flush()


def _follow_supervisor() -> None:
    """Wait until standard input is closed, then end this process and its session."""
    # os.read instead of sys.stdin: a daemon thread would hold the lock of the buffered reader at interpreter exit.
    while os.read(0, 4096):
        pass
    if os.name == "posix" and os.getsid(0) == os.getpid():
        end_session(os.getpid())
    os.kill(os.getpid(), signal.SIGTERM)  # handled in the main thread, which cleans up
    time.sleep(_GRACE_SECONDS)
    os._exit(128 + signal.SIGTERM)  # the main thread did not react in time


def _unwind(signum: int, frame: FrameType | None) -> NoReturn:
    raise _Terminated(128 + signum)


if __name__ == "__main__":
    end_after(main)
