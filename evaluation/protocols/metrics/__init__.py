"""Metrics by name: those of the protocol `standard`, and further ones that a comparison asks for.

Every other file of this folder registers further metrics, which `asg compare --metrics NAME` measures.
"""

from activestructure_gym.evaluation.protocols.metrics.base import (
    METRICS,
    Metric,
    MetricContext,
    get_metric,
    measure_metrics,
)

__all__ = ["METRICS", "Metric", "MetricContext", "get_metric", "measure_metrics"]
