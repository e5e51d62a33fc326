"""Print the tables of benchmark.md and ablation.md from benchmark.csv, which has a line per run.

    python docs/notebook/benchmark_table.py                          # the table, and differences if it has a ladder.
    python docs/notebook/benchmark_table.py runs/benchmark [MORE]    # add these runs to benchmark.csv first.
    python docs/notebook/benchmark_table.py --pairs A:B C:D          # only the differences A minus B and C minus D.
    python docs/notebook/benchmark_table.py --file ladder.csv        # read another file of this folder.
    python docs/notebook/benchmark_table.py --ladders                # differences between the rungs of all ladders.
    python docs/notebook/benchmark_table.py --phases                 # the tables of the phases.
    python docs/notebook/benchmark_table.py --learned                # the table of the learned policies.
    python docs/notebook/benchmark_table.py --readme                 # README's table, and the differences below it.

A ladder is the paper's ablation: variants A to E of ActiveStructure, of which each adds a component. Each variant is a
rung. References, which use ground truth, are on top and are never marked as the best. Numbers are means over scenes of
means over seeds, for the scenes and seeds that all policies have played. Differences are to the first of ``BASELINES``
with runs, in pairs of the same scene and seed. Their 95 % intervals are over the seeds within the scenes
(`paired_difference`). In the files of `POOLED` and in the table of all policies they are over the scenes.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from statistics import fmean

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import REFERENCE
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.report.tables.columns import value_of
from activestructure_gym.evaluation.statistics.aggregates import mean
from activestructure_gym.evaluation.statistics.intervals import Estimate
from activestructure_gym.evaluation.statistics.paired import Cell, PairedDifference, paired_difference
from activestructure_gym.policies.activestructure import LADDER

PLACE = Path(__file__).with_name("benchmark.csv")
BASELINES = ("hole_area", "pixel_only")
SHOWN = {  # columns by metric: heading, decimals, function that selects the best value
    "completion_ratio": ("C.R. (%) ↑", 1, max),
    "observed": ("observed (%) ↑", 1, max),
    "observed_area": ("exploration (%) ↑", 1, max),
    "psnr": ("PSNR (dB) ↑", 2, max),
    "depth_l1_cm": ("Depth (cm) ↓", 2, min),
}
# Files of few runs on many scenes, which are the sample: intervals are over the means of the scenes.
POOLED = (
    "procthor.csv", "phases_300.csv", "phases_2000.csv", "phases_rooms.csv", "learned_300.csv", "learned_2000.csv",
)  # fmt: skip
DIFFERENCES = {"observed_area": ("exploration", 1), "psnr": ("PSNR", 2)}  # differences to the baseline: name, decimals
OF_PAIRS = {
    "observed_area": ("exploration (points)", 1),
    "completion_ratio": ("C.R. (points)", 1),
    "observed": ("observed (points)", 1),
    "psnr": ("PSNR (dB)", 2),
}
README_ROWS = {  # rows of README's table: policy and its description
    f"{REFERENCE}oracle": "one-step choice with ground truth",
    "unknown_volume": "ours",
    "activestructure": "planes and phases on `unknown_volume`",
    "learned": "ours, trained on procedural apartments",
    "hole_area": "ours",
    "gs_planner": "published",
    "active_gs": "published",
    "fisherrf": "published, without its frontier goals",
    "random": "",
}
_FULL, _UNSEEN, _REVISITS = "activestructure", "activestructure?discovery=unseen", "revisits=true"
PHASES = {  # tables of the phases by file: pairs of policies
    "phases_300.csv": (
        (_FULL, "unknown_volume"),
        (_UNSEEN, "unseen"),
        (_FULL, "hole_area"),
        ("unseen", "unknown_volume"),
    ),
    "phases_2000.csv": (
        (_FULL, "unknown_volume"),
        (_UNSEEN, "unseen"),
        (_FULL, "unseen"),
        (_UNSEEN, _FULL),
        ("unseen", "unknown_volume"),
    ),
    "phases_rooms.csv": (
        (f"{_FULL}?{_REVISITS}", "unknown_volume"),
        (_FULL, "unknown_volume"),
        (_FULL, f"{_FULL}?{_REVISITS}"),
    ),
}
_DEFAULT, _LONG = "learned:d300@44f39cb9", "learned:long@66bb1ce7"  # trained on `default`, 300 and 2,000 frames
SHORT = {_DEFAULT: "learned:default", _LONG: "learned:long"}
LEARNED = {  # rows of the table of the learned policies by file: pairs of policies
    "learned_300.csv": (("learned", "unknown_volume"), (_DEFAULT, "unknown_volume"), (_DEFAULT, "learned")),
    "learned_2000.csv": ((_LONG, "unknown_volume"),),
}
HEADLINE = (  # differences over all starts, below README's table
    ("unknown_volume", "hole_area"),
    (_FULL, "hole_area"),
    ("learned", "hole_area"),
    (_FULL, "unknown_volume"),
    ("learned", "unknown_volume"),
)
STARTS = PLACE.with_name("starts.csv")  # runs of two earlier commits with other starts: seeds from 100 and 200 on
STATEMENTS = {  # rows of statements.md with differences in C.R. and PSNR: planner, the one that its paper improves on
    "active_gs": "frontier", "activegamer": "random", "activesplat": "anm_s", "anm_s": "activeinr",
    "fisherrf": "random", "fisherrf_path": "fisherrf", "gauss_mi": "fisherrf", "gavis": "fisherrf", "naruto": "random",
    "next_best_sense": "fisherrf", "r3_recon": "active_gs", "rt_guide": "fisherrf", "view_angle": "fisherrf",
}  # fmt: skip
RUNGS = (
    "**B**, visible planes", "**C**, surprise and discount", "**D**, deficiency centres",
    "**E**, phases (on pixels also smaller weights)",
)  # fmt: skip
LADDERS = {  # ladders by the heading of their column: file, lowest rung, metric in OF_PAIRS
    "on `hole_area`, 300 frames: exploration (points)": ("benchmark.csv", "hole_area", "observed_area"),
    "on `hole_area`, 2,000 frames: PSNR (dB)": ("ladder_2000.csv", "hole_area", "psnr"),
    "on pixels, 300 frames: exploration (points)": ("benchmark.csv", "pixel_only", "observed_area"),
    "on pixels, 2,000 frames: PSNR (dB)": ("ladder_2000.csv", "pixel_only", "psnr"),
}
OTHERS = (
    "tsdf_completion_ratio", "accuracy_cm", "ssim", "completion_cm", "late_psnr_rate", "late_depth_rate", "precision",
    "frames_to_80", "frames_to_85", "frames_to_90", "frames_to_95", "metres", "decisions", "gaussians", "collisions",
)  # fmt: skip
KEPT = (*SHOWN, *OTHERS)
Table = dict[str, dict[Cell, dict[str, float]]]  # metrics by policy, then by (scene, seed)


def added(place: Path, directories: Sequence[Path]) -> None:
    """Add the runs in comparison directories to the CSV file ``place``; lines of the same runs are replaced."""
    rows = {(r["policy"], r["scene"], r["seed"]): r for r in _rows(place)}
    for run in gather(directories).runs:
        values = {key: value_of(run, key) for key in KEPT}
        policy = run.job.policy if run.job.policy.kind == "reference" else run.policy
        row = {"policy": policy, "scene": run.scene, "seed": str(run.job.seed)}
        rows[row["policy"], row["scene"], row["seed"]] = row | {
            key: "" if value is None else f"{value:.6g}" for key, value in values.items()
        }
    with place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["policy", "scene", "seed", *KEPT], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[key] for key in sorted(rows))


def read(place: Path) -> Table:
    """Read the metrics of all runs in the CSV file ``place``, by policy and by scene and seed.

    A file in `POOLED` has one scene, and a "seed" per scene with the means over the seeds that all its policies played.
    """
    table: Table = {}
    for row in _rows(place):
        numbers = {key: float(row[key]) for key in KEPT if row.get(key)}
        table.setdefault(row["policy"], {})[row["scene"], int(row["seed"])] = numbers
    return _pooled(table) if place.name in POOLED else table


def _pooled(table: Table) -> Table:
    scenes = sorted({scene for runs in table.values() for scene, _ in runs})
    pooled: Table = {policy: {} for policy in table}
    for number, scene in enumerate(scenes):
        seeds = {policy: {seed for place, seed in runs if place == scene} for policy, runs in table.items()}
        common = sorted(set.intersection(*filter(None, seeds.values())))
        for policy in (policy for policy, own in seeds.items() if own and common):
            runs = [table[policy][scene, seed] for seed in common]
            keys = [key for key in KEPT if all(key in run for run in runs)]
            pooled[policy]["all", number] = {key: fmean(run[key] for run in runs) for key in keys}
    return pooled


def markdown(table: Table) -> str:
    """Return the table as Markdown, with a row per policy by decreasing C.R., and the columns that all runs have."""
    cells = _common(table)
    baseline = next((name for name in BASELINES if name in table), "")
    if not baseline:
        raise InputError(f"nothing to compare with: expected runs of {' or '.join(BASELINES)}, got {', '.join(table)}")
    table = {policy: {cell: runs[cell] for cell in cells} for policy, runs in table.items()}
    for policy in table:
        _values(table, policy, cells, "completion_ratio")  # by which the rows are sorted
    shown = {
        key: column for key, column in SHOWN.items() if all(key in r for runs in table.values() for r in runs.values())
    }
    means = {
        policy: {key: _mean({cell: run[key] for cell, run in runs.items()}) for key in shown}
        for policy, runs in table.items()
    }
    best = {
        key: choose(
            round(numbers[key], digits) for policy, numbers in means.items() if not policy.startswith(REFERENCE)
        )
        for key, (_, digits, choose) in shown.items()
    }
    heads = [heading for heading, _, _ in shown.values()]
    heads += [f"{name} minus `{baseline}`" for name, _ in DIFFERENCES.values()]
    lines = ["| policy | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    for policy in sorted(
        means, key=lambda name: (not name.startswith(REFERENCE), -means[name]["completion_ratio"], name)
    ):
        reference = policy.startswith(REFERENCE)
        cells = [f"`{policy.removeprefix(REFERENCE)}`, a reference" if reference else f"`{policy}`"]
        for key, (_, digits, _) in shown.items():
            text = f"{means[policy][key]:.{digits}f}"
            is_best = not reference and round(means[policy][key], digits) == best[key]
            cells.append(f"**{text}**" if is_best else text)
        cells += [_difference(table, policy, baseline, key, digits) for key, (_, digits) in DIFFERENCES.items()]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def pairs(table: Table, wanted: Sequence[tuple[str, str, str]]) -> str:
    """Return a table of paired differences as Markdown; ``wanted`` has (title, policy A, policy B) per row A - B."""
    heads = ["pairs", *(name for name, _ in OF_PAIRS.values()), "better in PSNR", "depth error, ratio"]
    lines = ["| | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    for words, ours, theirs in wanted:
        if missing := [name for name in (ours, theirs) if name not in table]:
            raise InputError(f"no runs of '{missing[0]}' here; expected A:B, each of {', '.join(sorted(table))}")
        psnr = _paired(table, ours, theirs, "psnr")
        found = [_difference(table, ours, theirs, key, digits) for key, (_, digits) in OF_PAIRS.items()]
        # The exponential of the mean difference of logarithms is the geometric mean of the ratios.
        depth = _paired(table, ours, theirs, "depth_l1_cm", math.log).difference
        cells = [str(psnr.pairs), *found, str(psnr.higher), _formatted(depth, 2, sign="", of=math.exp)]
        lines.append(f"| {words} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def all_policies() -> Table:
    """Return the runs in benchmark.csv, pooled by scene: "seeds" are scenes, with means over the common seeds.

    Policies with options, which are rungs of a ladder, are left out.
    """
    return _pooled({policy: runs for policy, runs in read(PLACE).items() if "?" not in policy})


def all_starts() -> Table:
    """Return the runs of the policies in `STARTS`, those of benchmark.csv included."""
    ours = read(PLACE)
    return {policy: ours[policy] | runs for policy, runs in read(STARTS).items()}


def headline() -> str:
    """Return the table of the differences in `HEADLINE` over all starts as Markdown."""
    return pairs(all_starts(), [(f"`{ours}` minus `{theirs}`", ours, theirs) for ours, theirs in HEADLINE])


def differences(file: str) -> str:
    """Return the table of paired differences of a file in `PHASES` or `LEARNED` as Markdown."""
    wanted = [
        (f"`{SHORT.get(ours, ours)}` minus `{SHORT.get(theirs, theirs)}`", ours, theirs)
        for ours, theirs in (PHASES | LEARNED)[file]
    ]
    return pairs(read(PLACE.with_name(file)), wanted)


def learned() -> str:
    """Return one table with the paired differences of all files in `LEARNED` as Markdown."""
    first, *more = (differences(file).splitlines(keepends=True) for file in LEARNED)
    return "".join([*first, *(line for lines in more for line in lines[2:])])


def ladder(table: Table, base: str) -> list[tuple[str, str, str]]:
    """Return (title, policy, policy of the rung below) for every rung of a ladder, then (title, top, base).

    Its lowest rung is ``base``. Return [] if the table does not have all rungs.
    """
    discovery = "" if base == "pixel_only" else f"?discovery={base}"
    top = LADDER[-1].replace("=pixel", f"={base.removesuffix('_only')}")
    rungs = [base, *(f"{name}{discovery}" for name in LADDER[1:-1]), top]
    if not all(name in table for name in rungs):
        return []
    return [*zip(RUNGS, rungs[1:], rungs), (f"all over `{base}`", top, base)]


def ladders(folder: Path) -> str:
    """Return a table as Markdown with the difference between each rung and the rung below, with a column per ladder.

    ``folder`` has the files of `LADDERS`.
    """
    columns = []
    for heading, (name, base, key) in LADDERS.items():
        table = read(folder / name)
        if not (rungs := ladder(table, base)):
            raise InputError(f"no ladder in {folder / name}; expected runs of all of {', '.join(LADDER)} on `{base}`")
        cells = [_difference(table, *pair, key, OF_PAIRS[key][1]).replace("-", "−") for _, *pair in rungs]
        columns.append([heading, *cells])
    rows = list(zip(["variant", *RUNGS, "all of it"], *columns, strict=True))
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|---|" + "---:|" * len(columns), *lines[1:]]) + "\n"


def statement(planner: str) -> str:
    """Return the differences of a planner to the one in `STATEMENTS`: C.R. in points and PSNR in dB, with intervals."""
    table, pair = all_policies(), (planner, STATEMENTS[planner])
    ratio, psnr = (_difference(table, *pair, key, OF_PAIRS[key][1]) for key in ("completion_ratio", "psnr"))
    return f"C.R. {ratio}, PSNR {psnr}".replace("-", "−")


def readme(table: Table) -> str:
    """Return README's table as Markdown: means over the scenes and seeds that all policies in `README_ROWS` played."""
    table = {policy: table[policy] for policy in README_ROWS}
    keys = {"observed": "observed (%) ↑", "observed_area": "exploration (%) ↑", "completion_ratio": "C.R. (%) ↑"}
    keys |= {"psnr": "PSNR (dB) ↑"}
    heads = [*keys.values(), *(f"{name} minus `hole_area`" for name, _ in DIFFERENCES.values())]
    lines = ["| planner | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    cells = _common(table)
    table = {policy: {cell: runs[cell] for cell in cells} for policy, runs in table.items()}
    for policy, words in README_ROWS.items():
        shown = [f"`{policy.removeprefix(REFERENCE)}`" + (f", {words}" if words else "")]
        for key in keys:
            shown.append(f"{_mean({cell: run[key] for cell, run in table[policy].items()}):.{SHOWN[key][1]}f}")
        differences = (_difference(table, policy, "hole_area", key, digits) for key, (_, digits) in DIFFERENCES.items())
        shown += [difference.replace("-", "−") for difference in differences]
        lines.append("| " + " | ".join(shown) + " |")
    return "\n".join(lines) + "\n"


def _rows(place: Path) -> list[dict[str, str]]:
    if not place.exists():
        return []
    with place.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _mean(values: dict[Cell, float]) -> float:
    scenes = sorted({scene for scene, _ in values})
    by_scene = [[value for (place, _), value in values.items() if place == scene] for scene in scenes]
    return float(mean([value for part in by_scene for value in part], [len(part) for part in by_scene]))


def _paired(table: Table, ours: str, theirs: str, key: str, of: Callable[[float], float] = float) -> PairedDifference:
    cells = table[ours].keys() & table[theirs].keys()
    values = ({cell: of(value) for cell, value in _values(table, one, cells, key).items()} for one in (ours, theirs))
    if (found := paired_difference(*values)) is None:
        raise InputError(f"'{ours}' and '{theirs}' have no scene and seed in common")
    return found


def _values(table: Table, policy: str, cells: Collection[Cell], key: str) -> dict[Cell, float]:
    """Return a policy's values of the metric ``key`` in ``cells``; raise `InputError` if a run has none."""
    for scene, seed in sorted(cells):
        if key not in table[policy][scene, seed]:
            raise InputError(f"the run of '{policy}' in {scene} with seed {seed} has no {key}: leave its policy out")
    return {cell: table[policy][cell][key] for cell in cells}


def _common(table: Table) -> set[Cell]:
    """Return the scenes and seeds that all policies have played; raise `InputError` if there are none."""
    if not (cells := set.intersection(*map(set, table.values()))):
        raise InputError(f"no scene and seed has runs of all policies: {', '.join(table)}")
    return cells


def policies_of(pair: str, table: Table) -> tuple[str, str]:
    """Split ``A:B`` into two policies of the table, whose names may contain colons too."""
    ends = [at for at, letter in enumerate(pair) if letter == ":"]
    splits = [(pair[:at], pair[at + 1 :]) for at in ends]
    return next((both for both in splits if set(both) <= set(table)), (splits or [(pair, "")])[0])


def _difference(table: Table, ours: str, theirs: str, key: str, digits: int) -> str:
    """Return the paired difference of the metric ``key``, ``ours`` minus ``theirs``, as text with ``digits`` decimals.

    The text is empty if both are the same policy.
    """
    if ours == theirs:
        return ""
    return _formatted(_paired(table, ours, theirs, key).difference, digits)


def _formatted(found: Estimate, digits: int, *, sign: str = "+", of: Callable[[float], float] = float) -> str:
    text = f"{of(found.value):{sign}.{digits}f}"
    if found.low is None or found.high is None:
        return text
    return f"{text} [{of(found.low):.{digits}f}, {of(found.high):.{digits}f}]"


def main() -> None:
    """Add the runs named on the command line to the file, and print the requested tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--file", default=PLACE.name)
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--pairs", nargs="+", metavar="A:B")
    instead.add_argument("--ladders", action="store_true")
    instead.add_argument("--readme", action="store_true")
    instead.add_argument("--phases", action="store_true")
    instead.add_argument("--learned", action="store_true")
    options = parser.parse_args()
    place = PLACE.with_name(options.file)
    if options.runs:
        added(place, options.runs)
    if options.ladders:
        print(ladders(PLACE.parent), end="")
        return
    if options.phases:
        print("\n".join(map(differences, PHASES)), end="")
        return
    if options.learned:
        print(learned(), end="")
        return
    if options.readme:
        print(f"{readme(read(PLACE))}\n{headline()}", end="")
        return
    table = read(place)
    if not table:
        raise InputError(f"no runs in {place}")
    if options.pairs:
        parts = [policies_of(pair, table) for pair in options.pairs]
        print(pairs(table, [(f"`{ours}` over `{theirs}`", ours, theirs) for ours, theirs in parts]), end="")
        return
    print(markdown(all_policies() if place == PLACE else table), end="")
    for rungs in filter(None, (ladder(table, base) for base in BASELINES)):
        print(f"\n{pairs(table, rungs)}", end="")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"benchmark_table.py: {error}")
