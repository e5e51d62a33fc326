"""Choose the scene and the seed of README's images: the pair of runs in benchmark.csv with the median gain in PSNR."""

from __future__ import annotations

import json
import runpy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.report.tables.columns import value_of

RUNS = Path(__file__).parents[1] / "notebook" / "benchmark.csv"
OURS, BASE = "activestructure", "hole_area"
NUMBERS = ("observed", "completion_ratio", "psnr", "metres")


def median_cell(table: dict[str, dict[tuple[str, int], dict[str, float]]]) -> tuple[str, int]:
    """Return the scene and the seed with the median difference in PSNR, OURS minus BASE.

    ``table`` has metrics by policy, then by (scene, seed). For an even number of pairs, it is the lower of the middle
    two.
    """
    gains = {cell: run["psnr"] - table[BASE][cell]["psnr"] for cell, run in table[OURS].items() if cell in table[BASE]}
    return sorted(gains, key=lambda cell: (gains[cell], cell))[(len(gains) - 1) // 2]


def stored() -> dict[str, dict[tuple[str, int], dict[str, float]]]:
    """Return the metrics of all runs in benchmark.csv, by policy, then by (scene, seed)."""
    table: dict[str, dict[tuple[str, int], dict[str, float]]]
    table = runpy.run_path(str(RUNS.with_name("benchmark_table.py")))["read"](RUNS)
    return table


def runs_of_cell(comparison: Path, policies: Sequence[str]) -> list[Run]:
    """Return the runs of ``policies`` with the scene and seed of `median_cell`, from a comparison's directory.

    Raise `InputError` if a run is missing.
    """
    scene, seed = median_cell(stored())
    found = {run.policy: run for run in gather([comparison]).runs if (run.scene, run.job.seed) == (scene, seed)}
    if missing := [policy for policy in policies if policy not in found]:
        raise InputError(f"{comparison} has no run of {missing[0]} on {scene} with seed {seed}")
    return [found[policy] for policy in policies]


def record(runs: Sequence[Run]) -> dict[str, Any]:
    """Return scene, seed and metrics of ``runs``, rounded as in benchmark.csv; a test compares the two."""
    return {
        "scene": runs[0].scene,
        "seed": runs[0].job.seed,
        "runs": {run.policy: {name: float(f"{value_of(run, name):.6g}") for name in NUMBERS} for run in runs},
    }


def write_record(runs: Sequence[Run], picture: Path) -> None:
    """Write the `record` of the runs in an image to a JSON file next to the image."""
    picture.with_suffix(".json").write_text(json.dumps(record(runs), indent=1) + "\n", encoding="utf-8")
