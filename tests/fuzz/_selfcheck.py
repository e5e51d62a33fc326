"""Cases that must fail, so that the tests see the harness notice them."""

from __future__ import annotations

import os
import signal
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np


def case(rng: np.random.Generator, folder: Path) -> Callable[[], object]:
    number = int(folder.name.removeprefix("_selfcheck"))
    return (_hang, _flood, _die, _complain, _behave)[number]


def _hang() -> None:
    time.sleep(30)


def _flood() -> None:
    held = np.ones(400 << 17)  # 400 MB
    time.sleep(held.min())


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _complain() -> None:
    try:
        raise KeyError("a worker's error that is only printed")
    except KeyError:
        traceback.print_exc()


def _behave() -> None:
    pass
