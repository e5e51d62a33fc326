"""Register implementations of the rasteriser, and report which ones can run on this machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from activestructure_gym.registry import Registry

WORKS = "works"  # status of a backend that can run


@dataclass(frozen=True)
class Backend:
    """Hold an implementation of `rasterizers.Rasterizer`: how to create it, and whether it can run."""

    make: Callable[[], Any]  # imports and returns the implementation; may load torch
    status: Callable[[], str] = lambda: WORKS  # returns `WORKS`, or one sentence on what is missing


BACKENDS: Registry[Backend] = Registry(
    "splatting backend",
    "backends",
    fits=lambda entry: isinstance(entry, Backend),
    wanted="a splatting.backends.Backend",
)


def backend_status() -> dict[str, str]:
    """Return for every backend ``"works"``, or one sentence on what is missing (shown by ``asg doctor``)."""
    return {name: BACKENDS.get(name).status() for name in BACKENDS}


def _cpu() -> Any:
    from activestructure_gym.splatting import cpu

    return cpu


def _by_torch(name: Literal["gsplat", "reference"]) -> Any:
    from activestructure_gym.splatting.torch_rasterizer import TorchRasterizer

    return TorchRasterizer(name)


def _gsplat_status() -> str:
    from activestructure_gym.splatting.gsplat_backend import gsplat_status

    return gsplat_status()


BACKENDS.register("cpu")(Backend(_cpu))
BACKENDS.register("gsplat")(Backend(lambda: _by_torch("gsplat"), _gsplat_status))
BACKENDS.register("reference")(Backend(lambda: _by_torch("reference")))
