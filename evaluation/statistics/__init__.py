"""Compute statistics of repeated runs: aggregates, intervals, paired differences and curves.

All functions are pure functions of numbers. The strata are the scenes: one array per scene, with one value per run.
Resampling keeps the scenes and draws the runs of each scene with replacement. The definitions are of [rliable], with
scenes in place of tasks and runs in place of seeds. The percentile bootstrap is of [efron1979].
"""

from activestructure_gym.evaluation.statistics.aggregates import (
    STATISTICS,
    Statistic,
    interquartile_mean,
    mean,
    median,
)
from activestructure_gym.evaluation.statistics.curves import BAND_REPEATS, area_under, curve_band, on_axis
from activestructure_gym.evaluation.statistics.improvement import probability_of_improvement, win_share
from activestructure_gym.evaluation.statistics.paired import PairedDifference, paired_difference
from activestructure_gym.evaluation.statistics.resampling import Estimate, estimate, pooled, stratified_draws

__all__ = [
    "BAND_REPEATS",
    "STATISTICS",
    "Estimate",
    "PairedDifference",
    "Statistic",
    "area_under",
    "curve_band",
    "estimate",
    "interquartile_mean",
    "mean",
    "median",
    "on_axis",
    "paired_difference",
    "pooled",
    "probability_of_improvement",
    "stratified_draws",
    "win_share",
]
