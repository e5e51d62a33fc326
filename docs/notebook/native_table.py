"""Print the tables of native.md from native.csv, which has a line per run.

    python docs/notebook/native_table.py                       # print the tables, draw docs/images/native_curves.svg
    python docs/notebook/native_table.py runs/native [MORE]    # add these runs to native.csv first
    python docs/notebook/native_table.py --file paper.csv      # read another file of this folder

The table of a scene has a row per policy by decreasing observed share. Numbers are means over the episodes (scene and
seed) that all policies have played. Differences are paired by episode, with 95 % intervals. *Minus chance* compares
with random choice under the same native settings (`chance_of`), at the frame at which the planner ended. A file without
such runs has differences to ``BASELINE``. "–" means that no run ended early; if only some did, it says how many.
A second table has the phases of the policies with phases, and a third one completion ratios by the protocols of papers,
with published ones.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from statistics import mean

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.report.charts.convergence import curve_of
from activestructure_gym.evaluation.report.charts.episode_series import bands
from activestructure_gym.evaluation.report.charts.plots import Line, line_chart, standalone
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.report.tables.columns import PLANNING, value_of
from activestructure_gym.evaluation.report.tables.published import PUBLISHED
from activestructure_gym.evaluation.statistics.paired import paired_difference
from activestructure_gym.policies import POLICIES
from activestructure_gym.specs import Spec

Episode = tuple[str, int]  # scene and seed
Runs = dict[Episode, dict[str, str]]  # lines of one policy
PLACE = Path(__file__).with_name("native.csv")
BASELINE = "activestructure-d"
PICTURE = Path(__file__).parents[1] / "images" / "native_curves.svg"
WHOLE = "houses_20_house_5"  # scene of the picture and of the table with all measures
FLOOR = "random?views_of="  # begins the name of chance with the native settings of a planner
# Planners with rows that precede a change of their rules, settings or planes (commits
# 5294a620, f918d54e, ee3ceb57 and d2991832).
OUTDATED = frozenset("""fisherrf_path popgs_cov_trace_block popgs_logdet_block""".split())
_FIRST = 2  # first point of a drawn curve; the first views show half of a room, which would flatten the curves
POINTS = 40  # points of a stored curve, at equal distances up to the last frame of the budget
SHOWN = {  # columns by metric: heading, decimals
    "observed": ("observed (%) ↑", 1),
    "observed_area": ("exploration (%) ↑", 1),
    "completion_ratio": ("C.R. (%) ↑", 1),
    "activesplat/completion_ratio": ("C.R. of ActiveSplat (%) ↑", 1),
    "naruto/completion_ratio": ("of NARUTO (%) ↑", 1),
    "activegamer/completion_ratio": ("of ActiveGAMER (%) ↑", 1),
    "psnr": ("PSNR (dB) ↑", 2),
    "ended_frame": ("ended at frame", 0),
}
OF_PAPERS = {  # planners with a published completion ratio: protocol, system in `PUBLISHED`
    "activegamer": ("activegamer", "ActiveGAMER"),
    "activesplat": ("activesplat", "ActiveSplat"),
    "anm_s": ("activesplat", "ANM-S"),
    "naruto": ("naruto", "NARUTO"),
}
STORED = (  # further columns of native.csv
    "tsdf_completion_ratio", "frames_to_80", "keyframes", "naruto/precision", "depth_l1_cm", "accuracy_cm",
    "frames_to_90", "frames_to_95", "decisions", "metres", "decision_s", "run_s",
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
CHANCE = "exploration minus chance"
_COUNTED = ("keyframes", "decision_s", "run_s")  # not metrics of the run
NAMES = ("policy", "scene", "seed", "mapper", "iterations")
COLUMNS = (*SHOWN, *STORED, *PHASES, "budget", "curve")


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
    mapper, budget = run.config["configuration"]["mapper"], run.config["configuration"]["frame_budget"]
    values["budget"] = budget
    frames, observed = curve_of(run, "frames", "observed")
    curve = np.interp(np.linspace(0, budget, POINTS + 1)[1:], frames, observed)
    names = (run.policy, run.scene, str(run.job.seed), mapper["name"], str(mapper["iterations"]))
    line = {key: "" if value is None else f"{value:.6g}" for key, value in values.items()}
    return dict(zip(NAMES, names)) | line | {"curve": " ".join(f"{value:.1f}" for value in curve)}


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
    """Return the table of all lines of a CSV file as Markdown, without empty columns and without rows of chance."""
    runs = by_policy(lines)
    shown = {key: column for key, column in SHOWN.items() if any(row[key] for row in lines)}
    heads = [heading for heading, _ in shown.values()]
    floors = {policy: chance_of(policy, runs) for policy in runs}
    has_chance = any(floors.values())
    differences = {} if has_chance or BASELINE not in runs else DIFFERENCES
    heads += [CHANCE] if has_chance else [f"{name} minus `{BASELINE}`" for name, _ in differences.values()]
    text = ["| planner | mapper/iterations | " + " | ".join(heads) + " |", "|---|---|" + "---:|" * len(heads)]
    for policy in sorted(runs, key=lambda policy: (-_mean(runs[policy], "observed"), policy)):
        if policy.startswith(FLOOR):
            continue
        cells = [_shown(runs[policy], key, digits) for key, (_, digits) in shown.items()]
        cells += minus_chance(runs[policy], runs.get(floors[policy]))[1:] if has_chance else []
        cells += [_difference(runs, policy, key, digits) for key, (_, digits) in differences.items()]
        mapper = " / ".join(sorted({f"{row['mapper']}/{row['iterations']}" for row in runs[policy].values()}))
        text.append(f"| `{policy}` | {mapper} | " + " | ".join(cells) + " |")
    return "\n".join(text) + "\n"


def chance_of(policy: str, runs: Collection[str]) -> str:
    """Return which of the ``runs`` has chance with the native settings of a policy; "" if there is none."""
    settings = settings_of(policy)
    named = [name for name in runs if name.startswith(FLOOR) and settings_of(name) == settings]
    plain = ["random"] if "random" in runs and settings == settings_of("random") else []
    return "" if policy.startswith("random") else next(iter(named + plain), "")


def settings_of(policy: str) -> str:
    """Return the native settings of a policy as text, without its paper's budget."""
    name = Spec(policy.removeprefix(FLOOR)).name
    return POLICIES.get(name).native_settings.describe().partition("; budget")[0]


def minus_chance(runs: Runs, floors: Runs | None) -> tuple[str, str]:
    """Return the differences of observed share and exploration to chance, up to the frame at which a planner ended.

    They are empty without ``floors``, and for runs whose curves were not stored.
    """
    if floors is None or not all(row["curve"] for row in runs.values()):
        return "", ""
    ends = {episode: float(row["ended_frame"] or row["budget"]) for episode, row in runs.items()}
    ours, theirs = ({one: _until(of[one], end) for one, end in ends.items()} for of in (runs, floors))
    observed, exploration = (
        _paired({one: both[i] for one, both in ours.items()}, {one: both[i] for one, both in theirs.items()}, 1)
        for i in range(2)
    )
    return observed, exploration


def _curve(row: dict[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the frames and the observed shares in percent of a stored curve."""
    curve = [0.0, *map(float, row["curve"].split())]
    return np.linspace(0, float(row["budget"]), len(curve)), np.array(curve)


def _until(row: dict[str, str], end: float) -> tuple[float, float]:
    """Return the observed share of a run at the frame ``end``, and its mean over the frames up to there, in percent."""
    frames, curve = _curve(row)
    last, before = float(np.interp(end, frames, curve)), frames < end
    return last, float(np.trapezoid([*curve[before], last], [*frames[before], end])) / end


def drawn() -> str:
    """Return charts of planners and chance over the frames in the scene `WHOLE` as SVG text."""
    runs, charts = by_policy([row for row in rows() if row["scene"] == WHOLE]), []
    for policy in sorted(name for name in runs if FLOOR + name in runs and name not in OUTDATED):
        lines = [
            Line(name, index, *np.mean([_curve(row) for row in runs[name].values()], axis=0)[:, _FIRST:])
            for index, name in enumerate((policy, FLOOR + policy))
        ]
        label = f"{policy}: observed [%]"
        charts.append(line_chart(lines, title=label, x_label="frames", y_label=label, y_includes=(60.0, 100.0)))
    table = [charts[i : i + 3] for i in range(0, len(charts), 3)]
    return standalone(table, ("planner", "chance on the same views"), title="Planners and chance, native setup")


def by_policy(lines: Sequence[dict[str, str]]) -> dict[str, Runs]:
    """Return the lines of a CSV file by policy and episode, for the episodes that all policies have played."""
    runs = _grouped(lines)
    common = set.intersection(*map(set, runs.values()))
    if not common:
        raise InputError(f"no scene and seed has runs of all policies: {', '.join(runs)}")
    return {policy: {one: row for one, row in own.items() if one in common} for policy, own in runs.items()}


def _grouped(lines: Sequence[dict[str, str]]) -> dict[str, Runs]:
    runs: dict[str, Runs] = {}
    for row in lines:
        runs.setdefault(row["policy"], {})[row["scene"], int(row["seed"])] = row
    return runs


def phases(lines: Sequence[dict[str, str]]) -> str:
    """Return the table of the phases as Markdown; "" if no policy has phases."""
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


def by_scene(lines: Sequence[dict[str, str]]) -> str:
    """Return a table of the observed shares in each scene as Markdown, with the differences to chance in brackets.

    The last column has the mean difference over all episodes with chance. Planners come in the order of the first
    scene, the one with most planners.
    """
    runs = _grouped(lines)
    planners = [policy for policy in runs if not policy.startswith(FLOOR)]
    scenes = [scene for scene, _ in Counter(scene for name in planners for scene, _ in runs[name]).most_common()]
    text = [
        f"| planner | {' | '.join(f'`{scene}`' for scene in scenes)} | minus chance, mean of the scenes |",
        "|---|" + "---:|" * (len(scenes) + 1),
    ]

    def height(policy: str) -> list[float]:
        own = runs[policy]
        return [-_mean(_in(own, scene), "observed") if _in(own, scene) else 0.0 for scene in scenes]

    for policy in sorted(planners, key=lambda policy: (height(policy), policy)):
        floors = runs.get(chance_of(policy, runs), {})
        cells = []
        for scene in (*scenes, None):
            own = runs[policy] if scene is None else _in(runs[policy], scene)
            both = sorted(one for one in own.keys() & floors.keys() if own[one]["curve"])
            common = {("any", number): one for number, one in enumerate(both)}
            less = minus_chance(*({one: of[common[one]] for one in common} for of in (own, floors)))[0]
            if scene is None:
                cells.append(less.partition(" ")[0])  # of few scenes, so without an interval
            elif own:
                cells.append(f"{_mean(own, 'observed'):.1f}" + (f" ({less})" if less else ""))
            else:
                cells.append("")
        text.append(f"| `{policy}` | " + " | ".join(cells) + " |")
    return "\n".join(text) + "\n"


def marked(text: str) -> str:
    """Return a Markdown table with a mark at the names of planners whose rows in native.csv are outdated."""
    for policy in OUTDATED:
        text = text.replace(f"| `{policy}` |", f"| `{policy}` † |")
    return text


def of_papers(lines: Sequence[dict[str, str]]) -> str:
    """Return a table of the completion ratios by the protocols of papers as Markdown, of chance in brackets.

    The last columns have the averages in [activestructure]; "–" means that the system did not complete every scene.
    """
    ratios = {
        (row["policy"], row["scene"], key): f"{float(row[key]):.1f}"
        for row in lines
        for key in SHOWN
        if key.endswith("/completion_ratio") and row[key]
    }
    scenes = [scene for scene, _ in Counter(scene for policy, scene, _ in ratios if policy in OF_PAPERS).most_common()]
    heads = [f"`{scene}`" for scene in scenes] + [table.dataset.title for table in PUBLISHED]
    text = [f"| planner | protocol | {' | '.join(heads)} |", "|---|---|" + "---:|" * len(heads)]
    for policy, (protocol, system) in OF_PAPERS.items():
        key, cells = f"{protocol}/completion_ratio", []
        for scene in scenes:
            chance = ratios.get((FLOOR + policy, scene, key), "")
            cells.append(ratios.get((policy, scene, key), "") + (f" ({chance})" if chance else ""))
        printed = [table.values[system]["C.R."][-1] for table in PUBLISHED]
        cells += ["–" if value is None else f"{value:.2f}" for value in printed]
        text.append(f"| `{policy}` | `{protocol}` | " + " | ".join(cells) + " |")
    return "\n".join(text) + "\n"


def _in(own: Runs, scene: str) -> Runs:
    return {one: row for one, row in own.items() if one[0] == scene}


def tables(place: Path = PLACE) -> dict[str, str]:
    """Return the tables of a CSV file as Markdown by name of their scenes.

    If the same policies have played all scenes, there is one table. Otherwise there are the table `by_scene` and one
    with all measures of the scene `WHOLE`.
    """
    lines, groups = rows(place), dict[str, list[dict[str, str]]]()
    for row in lines:
        groups.setdefault(row["scene"], []).append(row)
    every = ", ".join(groups)
    if len({frozenset(row["policy"] for row in group) for group in groups.values()}) == 1:
        return {every: "\n".join(filter(None, (markdown(lines), phases(lines))))}
    whole = "\n".join(filter(None, (markdown(groups[WHOLE]), phases(groups[WHOLE]))))
    return {name: marked(table) for name, table in {every: by_scene(lines), WHOLE: whole}.items()}


def _mean(own: Runs, key: str) -> float:
    return mean([float(row[key]) for row in own.values() if row[key]])


def _shown(own: Runs, key: str, digits: int) -> str:
    reached = sum(bool(row[key]) for row in own.values())
    if not reached:
        return "–" if key == "ended_frame" else ""
    text = f"{_mean(own, key):,.{digits}f}"
    return text if reached == len(own) else f"{text} ({reached} of {len(own)})"


def _difference(runs: dict[str, Runs], policy: str, key: str, digits: int) -> str:
    if policy == BASELINE:
        return ""
    ours, theirs = ({one: float(row[key]) for one, row in runs[name].items()} for name in (policy, BASELINE))
    return _paired(ours, theirs, digits)


def _paired(ours: dict[Episode, float], theirs: dict[Episode, float], digits: int) -> str:
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
    if not rows(place):
        raise InputError(f"'{place.name}' is not in {place.parent} or has no runs; add some: native_table.py DIRECTORY")
    for scenes, table in tables(place).items():
        print(f"{scenes}:\n\n{table}")
    if place == PLACE:
        print(marked(of_papers(rows())), end="")
        PICTURE.write_text(drawn(), encoding="utf-8")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"native_table.py: {error}")
