"""Define ``asg list features``, which lists the features of candidate views."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from activestructure_gym.evaluation.cli.fields import Switch, option
from activestructure_gym.evaluation.cli.listing import first_line, print_json, print_listed, print_text
from activestructure_gym.evaluation.cli.options import split_list
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.evaluation.cli.policies import features_asked


@dataclass(frozen=True)
class Features:
    """List the features of candidate views, or describe some."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional, option("[NAME ...]", "")] = ()
    """Describe these, with the policies that need them."""
    wide: Switch = False
    """Print all columns, whatever the width of the terminal."""
    json: Switch = False
    """Print JSON."""

    def run(self) -> int:
        """Print a table of all features, or the whole descriptions of the named features."""
        from activestructure_gym.features import FEATURES
        from activestructure_gym.features.table import columns_in_words, units_in_words

        names = list(dict.fromkeys(FEATURES.owner(name) for name in split_list(self.names)))
        if self.json:
            return print_json([_facts(name) for name in names or FEATURES])
        if names:
            print_text(make_console(), "\n\n".join(map(_described, names)))
            return 0
        rows = []
        for name in FEATURES:
            feature = FEATURES.get(name)
            more = [columns_in_words(feature), units_in_words(feature)] if self.wide else []
            rows.append([name, *more, first_line(feature)])
        heads = ["name", "columns", "unit", "what it is"] if self.wide else ["name", "what it is"]
        print_listed("Features of a candidate view", heads, rows, _HINT, wide=self.wide)
        return 0


_HINT = (
    "One with its columns and units: asg list features NAME. A policy declares those it needs; --features of "
    "asg train and features=... of an env take any."
)


def _facts(name: str) -> dict[str, Any]:
    from activestructure_gym.features import FEATURES

    feature = FEATURES.get(name)
    return {
        "name": name,
        "about": first_line(feature),
        "columns": FEATURES.columns(name),
        "units": feature.units,
        "low": [low if math.isfinite(low) else None for low in feature.low],
        "high": [high if math.isfinite(high) else None for high in feature.high],
    }


def _described(name: str) -> str:
    """Return a feature's docstring, columns, unit, range, and the policies that need it, as one text."""
    from activestructure_gym.features import FEATURES
    from activestructure_gym.features.table import columns_in_words, ranges_in_words, units_in_words
    from activestructure_gym.policies import POLICIES

    feature, columns = FEATURES.get(name), FEATURES.columns(name)
    asking = [policy for policy in POLICIES if {name, *columns} & set(features_asked(policy))]
    return "\n".join(
        [
            name,
            "",
            inspect.getdoc(feature) or "It has no description.",
            "",
            f"Columns: {columns_in_words(feature)}; unit: {units_in_words(feature)}; range: {ranges_in_words(feature)}",
            "",
            f"Needed by: {', '.join(asking) or 'no registered policy'}",
        ]
    )
