"""``python -m tests.fuzz``: many cases of some kinds, a table, and every failure with what repeats it."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.fuzz.harness import COLUMNS, Tally, kinds, run


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--kind", nargs="+", choices=kinds(), default=None, help="default: all")
    parser.add_argument("--cases", type=int, default=200, help="of each kind (default: 200)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", metavar="KIND:NUMBER", help="one case again; its files are kept")
    parser.add_argument("--say", action="store_true", help="print what every case came to")
    given = parser.parse_args()
    if given.only:
        kind, _, number = given.only.rpartition(":")
        if kind not in kinds() or not number.isdigit():
            parser.error(f"--only needs KIND:NUMBER with a kind of {', '.join(kinds())}")
        keep = Path(tempfile.mkdtemp(prefix="asg-fuzz-kept-"))
        tallies = [run(kind, [int(number)], seed=given.seed, keep=keep)]
        print(f"files: {keep}")
        given.say = True
    else:
        tallies = [run(kind, range(given.cases), seed=given.seed) for kind in given.kind or kinds()]
    for tally in tallies:
        for outcome in tally.outcomes if given.say else tally.failures:
            took = f"{outcome.seconds:.1f} s, {outcome.megabytes:.0f} MB"
            print(
                f"{outcome.verdict} --seed {tally.seed} --only {tally.kind}:{outcome.number} {took}: {outcome.message}"
            )
    print(table(tallies))
    return 1 if any(tally.failures for tally in tallies) else 0


def table(tallies: list[Tally]) -> str:
    """One row per kind."""
    rows = [COLUMNS, *(tally.row() for tally in tallies)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(row, widths)) for row in rows)


if __name__ == "__main__":
    sys.exit(main())
