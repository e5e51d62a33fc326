"""Describe the versions and the hardware that produce a result, for run directories and ``asg doctor``."""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from importlib import import_module, metadata
from pathlib import Path

from activestructure_gym._version import __version__
from activestructure_gym.cores import core_count

_SHOWING = {"cli", "report", "replay", "viewer", "benchmarks"}  # folders whose code cannot change a number of a run

# Packages whose version can change a number of a run, or how it is displayed.
PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "torch",
    "trimesh",
    "opencv-python-headless",
    "networkx",
    "gymnasium",
    "stable-baselines3",
    "pyrender",
    "safetensors",
    "pillow",
    "rich",
    "tyro",
)


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of each of `PACKAGES`, and the checksum of this package.

    The keys are the names of the packages, "python", and "code" for `code_checksum`. The value of a package that is not
    installed is "missing".
    """
    found = {"activestructure-gym": __version__, "code": code_checksum(), "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "missing"
    return found


@cache
def code_checksum() -> str:
    """Return the SHA-256, as hex digits, over the names and contents of this package's Python files.

    Folders that only display results or measure speed (`_SHOWING`) are left out, since they cannot change a number.
    """
    import activestructure_gym

    total = hashlib.sha256()
    for name in ("", "envs", "policies", "evaluation"):
        package = import_module(f"activestructure_gym.{name}") if name else activestructure_gym
        root = Path(package.__path__[0])
        for file in sorted(root.rglob("*.py")):
            parts = (*([name] if name else []), *file.relative_to(root).parts)
            if _SHOWING.isdisjoint(parts) and (name or parts[0] not in ("envs", "policies", "evaluation")):
                total.update("/".join(parts).encode() + b"\0" + file.read_bytes() + b"\0")
    return total.hexdigest()


def hardware() -> dict[str, str | int]:
    """Return the processor name, the number of usable cores, the memory in GiB, the system, and ``OMP_NUM_THREADS``.

    The host name and the user name are left out on purpose.
    """
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
