"""Register metrics by name: those of the protocol `standard`, and further ones for ``asg compare --metrics NAME``.

Every other file of this folder can register further metrics.
"""

from activestructure_gym.evaluation.protocols.metrics.base import (
    METRICS,
    Metric,
    MetricContext,
    added_metrics,
    get_metric,
    get_metrics,
    measure_metrics,
)

__all__ = ["METRICS", "Metric", "MetricContext", "added_metrics", "get_metric", "get_metrics", "measure_metrics"]
