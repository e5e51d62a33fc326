"""Sizes and devices that bombs are made of."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

HUGE = (10**6, 10**8, 2**31 - 1, 2**32, 2**40, 2**63 - 1, 2**63, 10**30)
DEVICES = ("/dev/zero", "/dev/stdin", "/proc/kmsg", "/proc/self/mem", "/dev/tty", "/etc/passwd", "/proc/self/environ")


def pick(rng: np.random.Generator, choices: Any) -> Any:
    """One of the choices."""
    return choices[int(rng.integers(len(choices)))]


def fan_out(rng: np.random.Generator) -> tuple[int, int]:
    """Levels and copies per level whose product of copies is astronomical."""
    return pick(rng, ((40, 2), (20, 4), (190, 2), (3, 3000), (2, 40_000)))


def put_devices(folder: Path) -> None:
    """A pipe and links to devices, to be named as files."""
    os.mkfifo(folder / "pipe")
    (folder / "zero").symlink_to("/dev/zero")
    (folder / "kernel").symlink_to("/proc/kmsg")
