"""``asg features``: what a policy can be told about a candidate view."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rich.markup import escape

from activestructure_gym.evaluation.cli.fields import Switch
from activestructure_gym.evaluation.cli.listing import first_line, print_json, print_listed
from activestructure_gym.evaluation.cli.output import plain_table


@dataclass(frozen=True)
class Features:
    """List the features of a candidate view that a policy can ask for: what each is, its columns and its unit."""

    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """All features: what each is, of which columns and in which unit."""
        from activestructure_gym.features import FEATURES
        from activestructure_gym.features.table import columns_in_words, units_in_words

        features = {name: FEATURES.get(name) for name in FEATURES}
        if self.json:
            return print_json(
                [
                    {
                        "name": name,
                        "about": first_line(feature),
                        "columns": FEATURES.columns(name),
                        "units": feature.units,
                        "low": [low if math.isfinite(low) else None for low in feature.low],
                        "high": [high if math.isfinite(high) else None for high in feature.high],
                    }
                    for name, feature in features.items()
                ]
            )
        table = plain_table("Features of a candidate view", "name", "columns", "unit", "what it is")
        for name, feature in features.items():
            words = (name, columns_in_words(feature), units_in_words(feature), first_line(feature))
            table.add_row(*map(escape, words))
        print_listed(table, "A policy names those it needs; --gains of asg train and gains=... of an env take any.")
        return 0
