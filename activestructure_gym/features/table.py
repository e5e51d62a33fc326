"""Describe the columns, units and ranges of features, for lists and for docs/reference/observation.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from activestructure_gym.features.registry import FEATURES, Feature

_MAX_NAMED = 4  # maximum number of columns that are all named; of more, only the first two and the last are


def columns_in_words(feature: Feature) -> str:
    """Return the names of a feature's columns; ``itself`` is the column named like the feature.

    Of more than four names, only the first two and the last are listed.
    """
    names = [column or "itself" for column in feature.columns]
    return ", ".join(names) if len(names) <= _MAX_NAMED else f"{names[0]}, {names[1]} .. {names[-1]} ({len(names)})"


def units_in_words(feature: Feature) -> str:
    """Return the unit of a feature if all columns have the same one, else the units of the columns in order."""
    return _same(feature.units)


def ranges_in_words(feature: Feature) -> str:
    """Return the range of a feature if all columns have the same one, else the ranges of the columns in order."""
    return _same([_range(low, high) for low, high in zip(feature.low, feature.high)])


def feature_table() -> str:
    """Return a Markdown table of this package's features: columns, units, ranges and files.

    The features ``NAME_cov`` have no row, since they all have the same unit and range. They are in the file of
    ``NAME``.
    """
    rows = ["| feature | columns | unit | range | file |", "|---|---|---|---|---|"]
    ours = f"{__name__.partition('.')[0]}."
    for name in FEATURES:
        feature = FEATURES.get(name)
        file = f"{feature.__module__.removeprefix(ours).replace('.', '/')}.py"
        if feature.__module__.startswith(ours) and name.removesuffix("_cov") not in set(FEATURES) - {name}:
            words = (columns_in_words(feature), units_in_words(feature), ranges_in_words(feature))
            rows.append(f"| `{name}` | {' | '.join(words)} | `{file}` |")
    return "\n".join(rows)


def _same(values: Sequence[str]) -> str:
    return values[0] if len(set(values)) == 1 else "; ".join(values)


def _range(low: float, high: float) -> str:
    if np.isfinite(low) and np.isfinite(high):
        return f"{low:g} to {high:g}"
    return f"from {low:g}" if np.isfinite(low) else f"to {high:g}" if np.isfinite(high) else "any"
