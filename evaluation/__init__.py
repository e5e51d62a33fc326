"""Compare policies: run grids of jobs, measure the maps, store the runs, and report the results.

`compare` runs scenes x policies x seeds into a directory. `open_comparison` and `read_run` read such a directory.
Metrics measure a map, protocols fix their constants, and statistics summarise repeated runs. No other part of the
package imports this one. Names are imported at first use, so that ``asg --help`` starts quickly.

>>> import numpy as np
>>> from activestructure_gym.evaluation import psnr
>>> round(psnr(np.full((2, 2, 3), 0.5), np.full((2, 2, 3), 0.6)), 2)
20.0
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from activestructure_gym.evaluation.archive.comparison import open_comparison
    from activestructure_gym.evaluation.archive.conditions import Conditions
    from activestructure_gym.evaluation.archive.jobs import Job
    from activestructure_gym.evaluation.archive.store import Run, read_run
    from activestructure_gym.evaluation.metrics import (
        SurfaceSamples,
        depth_l1,
        geometry_scores,
        ms_ssim,
        psnr,
        ssim,
    )
    from activestructure_gym.evaluation.protocols import (
        PROTOCOLS,
        ActiveGamerProtocol,
        OfflineProtocol,
        StandardProtocol,
        get_protocol,
    )
    from activestructure_gym.evaluation.protocols.metrics import METRICS, Metric, MetricContext
    from activestructure_gym.evaluation.running.api import compare
    from activestructure_gym.evaluation.running.comparison import Comparison, Result, run_comparison
    from activestructure_gym.evaluation.running.engines import Limits
    from activestructure_gym.evaluation.statistics import estimate, paired_difference, probability_of_improvement

_PLACES = {
    "archive.comparison": ("open_comparison",),
    "archive.conditions": ("Conditions",),
    "archive.jobs": ("Job",),
    "archive.store": ("Run", "read_run"),
    "metrics": ("SurfaceSamples", "depth_l1", "geometry_scores", "ms_ssim", "psnr", "ssim"),
    "protocols": ("PROTOCOLS", "ActiveGamerProtocol", "OfflineProtocol", "StandardProtocol", "get_protocol"),
    "protocols.metrics": ("METRICS", "Metric", "MetricContext"),
    "running.api": ("compare",),
    "running.comparison": ("Comparison", "Result", "run_comparison"),
    "running.engines": ("Limits",),
    "statistics": ("estimate", "paired_difference", "probability_of_improvement"),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _PLACES.items() for name in names}

__all__ = [
    "METRICS",
    "PROTOCOLS",
    "ActiveGamerProtocol",
    "Comparison",
    "Conditions",
    "Job",
    "Limits",
    "Metric",
    "MetricContext",
    "OfflineProtocol",
    "Result",
    "Run",
    "StandardProtocol",
    "SurfaceSamples",
    "compare",
    "depth_l1",
    "estimate",
    "geometry_scores",
    "get_protocol",
    "ms_ssim",
    "open_comparison",
    "paired_difference",
    "probability_of_improvement",
    "psnr",
    "read_run",
    "run_comparison",
    "ssim",
]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        return getattr(import_module(_MODULE_OF[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
