"""Print the tables of native.md from native.csv, which has a line per run.

    python docs/notebook/native_table.py                       # the tables
    python docs/notebook/native_table.py runs/native [MORE]    # add these runs to native.csv first

There is one table per scene, with a row per policy by decreasing observed share. Numbers are means over the seeds that
all policies have played. Differences are to ``BASELINE``, in pairs of the same seed, with 95 % bootstrap intervals; for
two seeds, the interval is from one difference to the other. "–" means that no run reached a level. If only some runs
reached it, their number is given. The native settings of the policies are printed below the tables.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import mean

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.report.tables.columns import PLANNING, value_of
from activestructure_gym.evaluation.statistics.paired import paired_difference
from activestructure_gym.policies import POLICIES

PLACE = Path(__file__).with_name("native.csv")
BASELINE = "hole_area"
SHOWN = {  # columns by metric: heading, decimals
    "observed": ("observed (%) ↑", 1),
    "observed_area": ("exploration (%) ↑", 1),
    "completion_ratio": ("C.R. (%) ↑", 1),
    "activesplat/completion_ratio": ("C.R. of ActiveSplat (%) ↑", 1),
    "naruto/completion_ratio": ("of NARUTO (%) ↑", 1),
    "activegamer/completion_ratio": ("of ActiveGAMER (%) ↑", 1),
    "tsdf_completion_ratio": ("C.R. surface (%) ↑", 1),
    "psnr": ("PSNR (dB) ↑", 2),
    "frames_to_80": ("frames to 80 %", 0),
    "ended_frame": ("ended at frame", 0),
    "keyframes": ("keyframes", 0),
}
STORED = (  # further columns of native.csv
    "depth_l1_cm", "accuracy_cm", "frames_to_90", "frames_to_95", "decisions", "metres", "decision_s", "run_s",
)  # fmt: skip
DIFFERENCES = {"observed": ("observed", 1), "psnr": ("PSNR", 2)}
_COUNTED = ("keyframes", "decision_s", "run_s")  # not metrics of the run
NAMES = ("policy", "scene", "seed", "mapper", "iterations")


def line_of(run: Run) -> dict[str, str]:
    """Return the metrics of a run as a line of native.csv, by column."""
    seconds, decisions = run.timing["seconds"], max(1, run.metrics["metrics"]["decisions"])
    values = {key: value_of(run, key) for key in (*SHOWN, *STORED) if key not in _COUNTED}
    values |= {
        "keyframes": len(run.trajectory["keyframes"]),
        "decision_s": sum(seconds.get(name, 0.0) for name in PLANNING) / decisions,
        "run_s": run.timing["total"] + seconds.get("loading", 0.0) + seconds.get("evaluation", 0.0),
    }
    mapper = run.config["configuration"]["mapper"]
    names = (run.policy, run.scene, str(run.job.seed), mapper["name"], str(mapper["iterations"]))
    return dict(zip(NAMES, names)) | {
        key: "" if value is None else f"{value:.6g}" for key, value in ((key, values[key]) for key in (*SHOWN, *STORED))
    }


def rows() -> list[dict[str, str]]:
    """Return all lines of native.csv, each by column; [] if the file does not exist."""
    if not PLACE.exists():
        return []
    with PLACE.open(newline="", encoding="utf-8") as file:
        return [dict.fromkeys([*SHOWN, *STORED], "") | row for row in csv.DictReader(file)]


def added(directories: Sequence[Path]) -> None:
    """Add the runs in comparison directories to native.csv; lines of the same runs are replaced."""
    lines = {tuple(row[name] for name in NAMES[:3]): row for row in rows()}
    for run in gather(directories).runs:
        row = line_of(run)
        lines[tuple(row[name] for name in NAMES[:3])] = row
    with PLACE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*NAMES, *SHOWN, *STORED], lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines[key] for key in sorted(lines))


def markdown(lines: Sequence[dict[str, str]]) -> str:
    """Return the table of one scene as Markdown, given its lines of native.csv, without empty columns."""
    runs: dict[str, dict[str, dict[str, str]]] = {}
    for row in lines:
        runs.setdefault(row["policy"], {})[row["seed"]] = row
    common = set.intersection(*map(set, runs.values()))
    runs = {policy: {seed: row for seed, row in by_seed.items() if seed in common} for policy, by_seed in runs.items()}
    shown = {key: column for key, column in SHOWN.items() if any(row[key] for row in lines)}
    heads = [heading for heading, _ in shown.values()]
    heads += [f"{name} minus `{BASELINE}`" for name, _ in DIFFERENCES.values()]
    text = ["| planner | mapper, iterations | " + " | ".join(heads) + " |", "|---|---|" + "---:|" * len(heads)]
    for policy in sorted(runs, key=lambda policy: (-_mean(runs[policy], "observed"), policy)):
        cells = [_shown(runs[policy], key, digits) for key, (_, digits) in shown.items()]
        cells += [_difference(runs, policy, key, digits) for key, (_, digits) in DIFFERENCES.items()]
        mapper = " / ".join(sorted({f"{row['mapper']}, {row['iterations']}" for row in runs[policy].values()}))
        text.append(f"| `{policy}` | {mapper} | " + " | ".join(cells) + " |")
    return "\n".join(text) + "\n"


def tables() -> dict[str, str]:
    """Return the table of every scene as Markdown, by scene."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in rows():
        found.setdefault(row["scene"], []).append(row)
    return {scene: markdown(lines) for scene, lines in found.items()}


def native_settings() -> str:
    """Return a Markdown table of the policies' native settings and their papers' budgets.

    Policies with equal settings share a row.
    """
    users: dict[str, list[str]] = {}
    for name in sorted({row["policy"] for row in rows()} & set(POLICIES)):
        users.setdefault(POLICIES.get(name).native_settings.describe(), []).append(f"`{name}`")
    text = "| planners | settings | budget in the paper |\n|---|---|---|\n"
    for settings, names in sorted(users.items(), key=lambda one: one[1]):
        ours, _, budget = settings.partition("; budget in its paper: ")
        text += f"| {', '.join(names)} | {ours} | {budget} |\n"
    return text


def _mean(by_seed: dict[str, dict[str, str]], key: str) -> float:
    return mean([float(row[key]) for row in by_seed.values() if row[key]])


def _shown(by_seed: dict[str, dict[str, str]], key: str, digits: int) -> str:
    reached = sum(bool(row[key]) for row in by_seed.values())
    if not reached:
        return "–"
    text = f"{_mean(by_seed, key):,.{digits}f}"
    return text if reached == len(by_seed) else f"{text} ({reached} of {len(by_seed)})"


def _difference(runs: dict[str, dict[str, dict[str, str]]], policy: str, key: str, digits: int) -> str:
    if policy == BASELINE or BASELINE not in runs:
        return ""
    ours, theirs = (
        {(row["scene"], int(seed)): float(row[key]) for seed, row in runs[name].items()} for name in (policy, BASELINE)
    )
    found = paired_difference(ours, theirs)
    if found is None:
        return ""
    value = found.difference
    text = f"{value.value:+.{digits}f}"
    return f"{text} [{value.low:.{digits}f}, {value.high:.{digits}f}]" if value.has_interval else text


def main(words: Sequence[str]) -> None:
    """Add the runs in the directories ``words`` to native.csv, and print the tables."""
    if words:
        added([Path(word) for word in words])
    for scene, table in tables().items():
        seeds = sorted({row["seed"] for row in rows() if row["scene"] == scene}, key=int)
        print(f"{scene}, seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}:\n\n{table}")
    print(native_settings(), end="")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"native_table.py: {error}")
