"""Write decisions.csv, the cost of one decision of each policy, which the site's table of policies shows.

    PYTHONPATH=. NUMBA_NUM_THREADS=1 OMP_NUM_THREADS=1 OMP_WAIT_POLICY=PASSIVE python docs/notebook/decisions.py

The state is that of `benchmarks.policies` in its default scene. The cost is the median processor time of three
decisions. It needs about ten minutes. The file is of 2026-11-28, from 2 shared cores with a load of
6 to 10: compare its rows with each other only.
"""

from __future__ import annotations

import csv
from pathlib import Path

from benchmarks.policies import run_policy_benchmark

PLACE = Path(__file__).with_name("decisions.csv")
KEPT = ("policy", "processor_s", "candidates", "gaussians", "keyframes", "threads")


def write(rows: list[dict], place: Path = PLACE) -> None:
    """Write the columns `KEPT` of the rows of `run_policy_benchmark` to a CSV file."""
    with place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, KEPT, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(row | {"processor_s": f"{row['processor_s']:.3g}"} for row in rows)


if __name__ == "__main__":
    write(run_policy_benchmark(repeats=3))
