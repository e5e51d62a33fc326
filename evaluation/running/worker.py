"""The process behind engines ``local`` and ``ray``: ``python -m`` this module, with a run directory to write.

Reads the job as one line of JSON from standard input, writes progress as JSON lines to standard output and everything
else to standard error. Ends when its standard input does: no worker outlives its supervisor.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import FrameType
from typing import IO, NoReturn

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.threads import thread_cap

_GRACE_SECONDS = 5.0  # between asking the main thread to clean up and ending without it


def main() -> int:
    """Run the one job; 0 when its directory is written."""
    signal.signal(signal.SIGTERM, _unwind)
    job_line = sys.stdin.readline()
    if not job_line:
        print("no job on standard input", file=sys.stderr)
        return 2
    # Progress keeps the real standard output; what policies print must not get in between.
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
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
    return 0


def _send(channel: IO[str], content: dict[str, object]) -> None:
    channel.write(json.dumps(content) + "\n")
    channel.flush()


def _follow_supervisor() -> None:
    # Below Python's buffered reader, whose lock a daemon thread would hold when the interpreter ends.
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)  # handled in the main thread, which cleans up
    time.sleep(_GRACE_SECONDS)
    os._exit(128 + signal.SIGTERM)  # it is busy elsewhere; nobody waits for its result


def _unwind(signum: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + signum)


if __name__ == "__main__":
    sys.exit(main())
