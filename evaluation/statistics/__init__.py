"""Compute statistics of repeated runs: aggregates, intervals, paired differences and curves.

All functions are pure functions of numbers. The strata are the scenes: one array per scene, with one value per run.
The aggregates are those of [rliable], with scenes in place of tasks and runs in place of seeds.
"""

from activestructure_gym.evaluation.statistics.aggregates import (
    STATISTICS,
    Statistic,
    interquartile_mean,
    mean,
    median,
)
from activestructure_gym.evaluation.statistics.curves import area_under, curve_band, on_axis
from activestructure_gym.evaluation.statistics.improvement import probability_of_improvement, win_share
from activestructure_gym.evaluation.statistics.intervals import (
    Estimate,
    degrees_of_freedom,
    estimate,
    pooled,
    standard_error,
    stratified_draws,
    t_quantile,
)
from activestructure_gym.evaluation.statistics.paired import PairedDifference, paired_difference

__all__ = [
    "STATISTICS",
    "Estimate",
    "PairedDifference",
    "Statistic",
    "area_under",
    "curve_band",
    "degrees_of_freedom",
    "estimate",
    "interquartile_mean",
    "mean",
    "median",
    "on_axis",
    "paired_difference",
    "pooled",
    "probability_of_improvement",
    "standard_error",
    "stratified_draws",
    "t_quantile",
    "win_share",
]
