"""Print the tables of native.md from native.csv, which has a line per run.

    python docs/notebook/native_table.py                       # the tables
    python docs/notebook/native_table.py runs/native [MORE]    # add these runs to native.csv first
    python docs/notebook/native_table.py --file paper.csv      # read another file of this folder

There is one table per scene, with a row per policy by decreasing observed share. Numbers are means over the seeds that
all policies have played. Differences are to the first of ``BASELINES`` with
runs, in pairs of the same seed, with 95 % bootstrap intervals; for
two seeds, the interval is from one difference to the other. "–" means that no run reached a level. If only some runs
reached it, their number is given. A second table has the phases of the policies with phases. The native settings of
the policies are printed below the tables.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import mean

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.charts.episode_series import bands
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.report.tables.columns import PLANNING, value_of
from activestructure_gym.evaluation.statistics.paired import paired_difference
from activestructure_gym.policies import POLICIES

PLACE = Path(__file__).with_name("native.csv")
BASELINES = ("hole_area", "activestructure-d")
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
PHASES = {  # columns of the second table: heading, decimals
    "phase_2": ("phase II at frame", 0),
    "phase_3": ("phase III at frame", 0),
    "settled": ("settled at frame", 0),
    "revisits": ("revisits", 0),
    "extra_iterations": ("their extra iterations", 0),
    "deficient_2": ("deficient area (m²) at phase II", 1),
    "deficient_3": ("at phase III", 1),
    "deficient": ("at the end", 1),
}
DIFFERENCES = {"observed": ("observed", 1), "psnr": ("PSNR", 2)}
_COUNTED = ("keyframes", "decision_s", "run_s")  # not metrics of the run
NAMES = ("policy", "scene", "seed", "mapper", "iterations")
COLUMNS = (*SHOWN, *STORED, *PHASES)


def line_of(run: Run) -> dict[str, str]:
    """Return the metrics of a run as a line of native.csv, by column."""
    seconds, decisions = run.timing["seconds"], max(1, run.metrics["metrics"]["decisions"])
    values = {key: value_of(run, key) for key in (*SHOWN, *STORED) if key not in _COUNTED}
    values |= phases_of(run)
    values |= {
        "keyframes": len(run.trajectory["keyframes"]),
        "decision_s": sum(seconds.get(name, 0.0) for name in PLANNING) / decisions,
        "run_s": run.timing["total"] + seconds.get("loading", 0.0) + seconds.get("evaluation", 0.0),
    }
    mapper = run.config["configuration"]["mapper"]
    names = (run.policy, run.scene, str(run.job.seed), mapper["name"], str(mapper["iterations"]))
    return dict(zip(NAMES, names)) | {
        key: "" if value is None else f"{value:.6g}" for key, value in ((key, values[key]) for key in COLUMNS)
    }


def phases_of(run: Run) -> dict[str, float | None]:
    """Return the columns `PHASES` of a run; all are None for a policy without phases."""
    found: dict[str, float | None] = dict.fromkeys(PHASES)
    begun = {band.phase.split()[0]: band.start for band in reversed(bands(run.steps))}
    if not begun:
        return found
    areas = {step["frames"]: float((step.get("graph") or {}).get("deficiency_area", 0.0)) for step in run.steps}
    for key, phase in {"2": "II", "3": "III"}.items():
        found[f"phase_{key}"] = begun.get(phase)
        found[f"deficient_{key}"] = areas.get(begun[phase]) if phase in begun else None
    extra = float((run.trajectory["keyframe_rounds"] - 1).sum()) * run.config["configuration"]["mapper"]["iterations"]
    return found | {
        "settled": begun.get("settled"),
        "revisits": sum(bool(step["view"]["revisit"]) for step in run.steps),
        "extra_iterations": extra,
        "deficient": areas[run.steps[-1]["frames"]],
    }


def rows(place: Path = PLACE) -> list[dict[str, str]]:
    """Return all lines of the CSV file ``place``, each by column; [] if the file does not exist."""
    if not place.exists():
        return []
    with place.open(newline="", encoding="utf-8") as file:
        return [dict.fromkeys(COLUMNS, "") | row for row in csv.DictReader(file)]


def added(place: Path, directories: Sequence[Path]) -> None:
    """Add the runs in comparison directories to the CSV file ``place``; lines of the same runs are replaced."""
    lines = {tuple(row[name] for name in NAMES[:3]): row for row in rows(place)}
    for run in gather(directories).runs:
        row = line_of(run)
        lines[tuple(row[name] for name in NAMES[:3])] = row
    with place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*NAMES, *COLUMNS], lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines[key] for key in sorted(lines))


def markdown(lines: Sequence[dict[str, str]]) -> str:
    """Return the table of one scene as Markdown, given its lines of a CSV file, without empty columns."""
    runs = by_policy(lines)
    shown = {key: column for key, column in SHOWN.items() if any(row[key] for row in lines)}
    heads = [heading for heading, _ in shown.values()]
    baseline = next((name for name in BASELINES if name in runs), "")
    heads += [f"{name} minus `{baseline}`" for name, _ in DIFFERENCES.values() if baseline]
    text = ["| planner | mapper, iterations | " + " | ".join(heads) + " |", "|---|---|" + "---:|" * len(heads)]
    for policy in sorted(runs, key=lambda policy: (-_mean(runs[policy], "observed"), policy)):
        cells = [_shown(runs[policy], key, digits) for key, (_, digits) in shown.items()]
        cells += [_difference(runs, policy, baseline, key, n) for key, (_, n) in DIFFERENCES.items() if baseline]
        mapper = " / ".join(sorted({f"{row['mapper']}, {row['iterations']}" for row in runs[policy].values()}))
        text.append(f"| `{policy}` | {mapper} | " + " | ".join(cells) + " |")
    return "\n".join(text) + "\n"


def by_policy(lines: Sequence[dict[str, str]]) -> dict[str, dict[str, dict[str, str]]]:
    """Return the lines of one scene by policy and seed, for the seeds that all policies have played."""
    runs: dict[str, dict[str, dict[str, str]]] = {}
    for row in lines:
        runs.setdefault(row["policy"], {})[row["seed"]] = row
    common = set.intersection(*map(set, runs.values()))
    return {policy: {seed: row for seed, row in by_seed.items() if seed in common} for policy, by_seed in runs.items()}


def phases(lines: Sequence[dict[str, str]]) -> str:
    """Return the table of the phases in one scene as Markdown; "" if no policy has phases."""
    runs = {policy: runs for policy, runs in by_policy(lines).items() if any(row["deficient"] for row in runs.values())}
    if not runs:
        return ""
    text = [
        "| planner | " + " | ".join(heading for heading, _ in PHASES.values()) + " |",
        "|---|" + "---:|" * len(PHASES),
    ]
    for policy, own in runs.items():
        text.append(f"| `{policy}` | " + " | ".join(_shown(own, key, n) for key, (_, n) in PHASES.items()) + " |")
    return "\n".join(text) + "\n"


def tables(place: Path = PLACE) -> dict[str, str]:
    """Return the tables of every scene as Markdown, by scene."""
    found: dict[str, list[dict[str, str]]] = {}
    for row in rows(place):
        found.setdefault(row["scene"], []).append(row)
    return {scene: "\n".join(filter(None, (markdown(lines), phases(lines)))) for scene, lines in found.items()}


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


def _difference(runs: dict[str, dict[str, dict[str, str]]], policy: str, baseline: str, key: str, digits: int) -> str:
    if policy == baseline:
        return ""
    ours, theirs = (
        {(row["scene"], int(seed)): float(row[key]) for seed, row in runs[name].items()} for name in (policy, baseline)
    )
    found = paired_difference(ours, theirs)
    if found is None:
        return ""
    value = found.difference
    text = f"{value.value:+.{digits}f}"
    return f"{text} [{value.low:.{digits}f}, {value.high:.{digits}f}]" if value.has_interval else text


def main(words: Sequence[str]) -> None:
    """Add the runs in the directories among ``words`` to a CSV file, and print its tables."""
    parser = argparse.ArgumentParser(description="Print the tables of native.md from a CSV file with a line per run.")
    parser.add_argument("runs", nargs="*", type=Path, help="add the runs in these directories first")
    parser.add_argument("--file", default=PLACE.name, help="read this file of docs/notebook (native.csv)")
    asked = parser.parse_args(words)
    place = PLACE.with_name(asked.file)
    if asked.runs:
        added(place, asked.runs)
    for scene, table in tables(place).items():
        seeds = sorted({row["seed"] for row in rows(place) if row["scene"] == scene}, key=int)
        print(f"{scene}, seed{'s' * (len(seeds) > 1)} {', '.join(seeds)}:\n\n{table}")
    if place == PLACE:
        print(native_settings(), end="")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"native_table.py: {error}")
