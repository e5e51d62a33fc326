"""``asg features``: what a policy can be told about a candidate view."""

from __future__ import annotations

from dataclasses import dataclass

from rich.markup import escape

from activestructure_gym.evaluation.cli.fields import Switch
from activestructure_gym.evaluation.cli.listing import first_line, grouped, print_json, print_listed
from activestructure_gym.evaluation.cli.output import plain_table


@dataclass(frozen=True)
class Features:
    """List the gains of a candidate view that a policy can ask for: what each is, and its unit."""

    json: Switch = False
    """For programs."""

    def run(self) -> int:
        """All gains: what each is, and in which unit."""
        from activestructure_gym.features import GAINS
        from activestructure_gym.features.units import UNITS

        rows = [{"name": name, "about": first_line(GAINS.get(name)), "unit": UNITS.get(name, "")} for name in GAINS]
        if self.json:
            return print_json(rows)
        table = plain_table("Gains of a candidate view", "name", "unit", "what it is")
        for name in grouped([row["name"] for row in rows]):
            row = next(row for row in rows if row["name"] == name.partition(" .. ")[0])
            table.add_row(*map(escape, (name, row["unit"], row["about"])))
        print_listed(table, "A policy names those it needs; --gains of asg train and gains=... of an env take any.")
        return 0
