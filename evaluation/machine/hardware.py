"""Versions and hardware that a result was made with, for the archive and for ``asg doctor``."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

from activestructure_gym._version import __version__
from activestructure_gym.cores import core_count

# What a number can depend on.
PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "torch",
    "embreex",
    "trimesh",
    "opencv-python-headless",
    "networkx",
    "gymnasium",
    "stable-baselines3",
    "pyrender",
    "safetensors",
    "matplotlib",
    "pillow",
    "rich",
    "tyro",
)


def versions() -> dict[str, str]:
    """Version of this package, of Python and of every package that takes part; "missing" where it is not installed."""
    found = {"activestructure-gym": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "missing"
    return found


def hardware() -> dict[str, str | int]:
    """Processor, cores this process may use, memory and system. No host name, no user name."""
    return {
        "processor": _processor(),
        "cores": core_count(),
        "memory_gb": _memory_gb(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "threads": os.environ.get("OMP_NUM_THREADS", ""),
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine() or "unknown"


def _memory_gb() -> int:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30)
    except (AttributeError, ValueError, OSError):
        return 0
