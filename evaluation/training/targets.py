"""Compute training targets from an expert's scores of N states x K candidates: probabilities, or ordinal ranks."""

from __future__ import annotations

import numpy as np


def soft_labels(scores: np.ndarray, valid: np.ndarray, temperature: float) -> np.ndarray:  # [N, K] x2 -> [N, K]
    """Return softmax(score / (largest score x temperature)) over the valid candidates of each state.

    The probabilities of a state are equal if all its scores are 0. Invalid candidates have the probability 0.
    """
    scores = np.where(valid, scores, -np.inf)
    most = np.maximum(scores.max(axis=1, keepdims=True), 0.0)
    with np.errstate(invalid="ignore"):
        shares = np.where(valid, np.where(most > 0, scores / np.where(most > 0, most, 1.0), 0.0), -np.inf)
    weights = np.exp((shares - shares.max(axis=1, keepdims=True)) / temperature)
    return weights / weights.sum(axis=1, keepdims=True)


def standardised(scores: np.ndarray, valid: np.ndarray) -> np.ndarray:  # [N, K] x2 -> [N, K]
    """Return the z-scores over the valid candidates of each state; 0 for invalid ones, and if all scores are equal.

    Standardising per state removes the decrease of scores during an episode (VIN-NBV).
    """
    count = valid.sum(axis=1, keepdims=True)
    mean = np.where(valid, scores, 0.0).sum(axis=1, keepdims=True) / count
    variance = np.where(valid, (scores - mean) ** 2, 0.0).sum(axis=1, keepdims=True) / count
    deviation = np.sqrt(variance)
    safe = np.where(deviation > 1e-12, deviation, 1.0)
    return np.where(valid & (deviation > 1e-12), (scores - mean) / safe, 0.0)


def bin_edges(values: np.ndarray, bins: int) -> np.ndarray:  # [V] -> [bins - 1], rising
    """Return the borders that divide ``values`` into bins of equal counts; borders coincide for many equal values."""
    return np.quantile(values, np.arange(1, bins) / bins)


def ordinal(values: np.ndarray, edges: np.ndarray) -> np.ndarray:  # any shape -> the same, int64 in 0 .. len(edges)
    """Return the ordinal rank of each value: the number of borders ``edges`` below it."""
    return np.searchsorted(edges, values, side="left").astype(np.int64)
