"""Prints the table of benchmark.md, "Native terms", from native.csv, which has a line per run.

    python docs/notebook/native_table.py                       # the table
    python docs/notebook/native_table.py runs/native [MORE]    # these runs are put into native.csv first

One table per scene and seed, who has observed most first. What nobody reaches is "–".
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.columns import PLANNING, value_of
from activestructure_gym.evaluation.report.results import gather

PLACE = Path(__file__).with_name("native.csv")
SHOWN = {  # key: heading, digits
    "observed": ("observed (%) ↑", 1),
    "observed_area": ("area (%) ↑", 1),
    "completion_ratio": ("C.R. (%) ↑", 1),
    "tsdf_completion_ratio": ("C.R. surface (%) ↑", 1),
    "psnr": ("PSNR (dB) ↑", 2),
    "depth_l1_cm": ("Depth (cm) ↓", 2),
    "accuracy_cm": ("Acc (cm) ↓", 2),
    "frames_to_80": ("frames to 80 %", 0),
    "frames_to_90": ("90 %", 0),
    "frames_to_95": ("95 %", 0),
    "decisions": ("decisions", 0),
    "keyframes": ("keyframes", 0),
    "metres": ("way (m)", 0),
    "decision_s": ("s per decision", 1),
    "run_s": ("run (s)", 0),
}
NAMES = ("policy", "scene", "seed", "mapper")


def line_of(run: Run) -> dict[str, str]:
    """The numbers of a run as the file has them."""
    seconds, decisions = run.timing["seconds"], max(1, run.metrics["metrics"]["decisions"])
    values = {key: value_of(run, key) for key in SHOWN if key not in ("keyframes", "decision_s", "run_s")}
    values |= {
        "keyframes": len(run.trajectory["keyframes"]),
        "decision_s": sum(seconds.get(name, 0.0) for name in PLANNING) / decisions,
        "run_s": run.timing["total"] + seconds.get("loading", 0.0) + seconds.get("evaluation", 0.0),
    }
    names = (run.policy, run.scene, str(run.job.seed), run.config["configuration"]["mapper"]["name"])
    return dict(zip(NAMES, names)) | {
        key: "" if value is None else f"{value:.6g}" for key, value in ((key, values[key]) for key in SHOWN)
    }


def rows() -> list[dict[str, str]]:
    """All lines of the file."""
    if not PLACE.exists():
        return []
    with PLACE.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def added(directories: Sequence[Path]) -> None:
    """Put the runs of comparisons into the file; one that is there already is replaced."""
    lines = {tuple(row[name] for name in NAMES[:3]): row for row in rows()}
    for run in gather(directories).runs:
        row = line_of(run)
        lines[tuple(row[name] for name in NAMES[:3])] = row
    with PLACE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*NAMES, *SHOWN], lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines[key] for key in sorted(lines))


def markdown(lines: Sequence[dict[str, str]]) -> str:
    """A table of these runs."""
    heads = " | ".join(heading for heading, _ in SHOWN.values())
    text = [f"| planner | mapper | {heads} |", "|---|---|" + "---:|" * len(SHOWN)]
    for row in sorted(lines, key=lambda row: (-float(row["observed"]), row["policy"])):
        cells = [f"{float(row[key]):,.{digits}f}" if row[key] else "–" for key, (_, digits) in SHOWN.items()]
        text.append(f"| `{row['policy']}` | {row['mapper']} | " + " | ".join(cells) + " |")
    return "\n".join(text) + "\n"


def tables() -> dict[tuple[str, str], str]:
    """The table of every scene and seed."""
    found: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in rows():
        found.setdefault((row["scene"], row["seed"]), []).append(row)
    return {key: markdown(lines) for key, lines in found.items()}


if __name__ == "__main__":
    if sys.argv[1:]:
        added([Path(word) for word in sys.argv[1:]])
    for (scene, seed), table in tables().items():
        print(f"{scene}, seed {seed}:\n\n{table}")
