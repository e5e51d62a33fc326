"""Describe metrics as columns of tables: heading, unit, decimals, and whether lower or higher is better."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from activestructure_gym.errors import pluralised, unknown_name
from activestructure_gym.evaluation.archive.jobs import slug
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.metrics.planning import LEVELS, ended_frame
from activestructure_gym.evaluation.protocols.metrics import Metric, standard
from activestructure_gym.evaluation.protocols.metrics.base import Best
from activestructure_gym.evaluation.protocols.metrics.without_truth import WITHOUT_TRUTH

# Stages of timing.json whose seconds are added up in the columns "planning", "mapping" and "volume, planes".
PLANNING = ("planning", "features", "policy")
MAPPING = ("mapping",)
WORLD = ("volume", "planes")


@dataclass(frozen=True)
class Column:
    """Hold the description of one metric as a column of tables."""

    key: str  # field of metrics.json, "PROTOCOL/FIELD" for a further protocol, or another key that `value_of` knows
    header: str  # name in headings
    unit: str
    digits: int  # number of printed decimals
    best: Best | None = None  # which values are better; None for costs and sizes
    meaning: str = ""  # definition, shown as a tooltip

    @property
    def arrow(self) -> str:
        """Return an arrow: up if higher values are better, down if lower ones are, empty for a cost."""
        return {"lowest": "↓", "highest": "↑", None: ""}[self.best]

    @property
    def title(self) -> str:
        """Return the heading of the column: name, unit and arrow, as in "PSNR (dB) ↑"."""
        return " ".join(part for part in (self.header, f"({self.unit})" if self.unit else "", self.arrow) if part)

    @property
    def tie(self) -> float:
        """Return the largest difference of two values that counts as a tie: half a unit of the last printed digit."""
        return 0.5 * 10.0**-self.digits

    @property
    def sign(self) -> int:
        """Return -1 if smaller is better, else 1."""
        return -1 if self.best == "lowest" else 1

    @classmethod
    def of(cls, metric: Metric) -> Column:
        """Return the column that describes ``metric``."""
        meaning = metric.meaning.replace("{near}", "the distance threshold")
        return cls(metric.name, metric.label, metric.unit, metric.digits, metric.best, meaning)


# Completion ratio of the means of the Gaussians, completion ratio of the TSDF surface, and observed share.
RATIOS = tuple(map(Column.of, (standard.RATIO, standard.TSDF_RATIO, standard.OBSERVED)))
_EXPLORATION = Column(
    "observed_area", "exploration", "%", 1, "highest", "mean observed share of the surface over the frame budget"
)

# Columns of the overview: metrics, then costs.
COLUMNS = (
    *map(Column.of, (standard.ACCURACY, standard.COMPLETION)),
    *RATIOS,
    *map(Column.of, (standard.PRECISION, standard.PSNR, standard.SSIM)),
    Column("frames", "frames", "", 0),
    Column("metres", "path", "m", 1),
    Column("seconds", "time", "s", 1),
)

# Metrics of the paper's Tables 1 to 3, in the paper's order.
QUALITY = tuple(map(Column.of, standard.STANDARD))

# Prefix of the keys for "frames until a level is reached". For a run that does not reach the level, the value is the
# frame budget, which is a lower bound.
LOWER_BOUND = "least_"
# Speed of exploration, and improvement in the second half of the frame budget; see `metrics.planning`.
PROGRESS = (
    *(Column(f"{LOWER_BOUND}frames_to_{level}", f"frames to {level} %", "", 0, "lowest") for level in LEVELS),
    _EXPLORATION,
    Column("late_psnr_rate", "late PSNR", "dB / 100 frames", 2, "highest"),
    Column("late_depth_rate", "late Depth", "cm / 100 frames", 2, "lowest"),
)

_SIZES = (Column("keyframes", "keyframes", "", 0), Column("gaussians", "Gaussians", "", 0))
COSTS = (
    Column("frames", "frames", "", 0),
    Column("metres", "path", "m", 1),
    Column("decisions", "decisions", "", 0),
    Column("ended_frame", "ended at frame", "", 0, meaning="last frame of a movement, if later decisions only stayed"),
    *_SIZES,
    Column("collisions", "collisions", "", 0),
    Column("planning_seconds", "planning", "s", 1),
    Column("mapping_seconds", "mapping", "s", 1),
    Column("world_seconds", "volume, planes", "s", 1),
    Column("sensor_seconds", "sensor", "s", 1),
    Column("seconds", "total", "s", 1),
)

# Main metrics: those of the cards and of the charts of differences. Accuracy and precision are left out, since a policy
# that maps little has the best values of both.
MAIN = (
    RATIOS[2], _EXPLORATION, RATIOS[0], Column.of(standard.PSNR), Column.of(standard.DEPTH),
    *map(Column.of, WITHOUT_TRUTH),
)  # fmt: skip


def own_metrics(runs: Sequence[Run]) -> list[Metric]:
    """Return the metrics that users have added to the runs, for example by the option ``--metrics``."""
    found = {one["name"]: one for run in runs for one in run.metrics.get("own_metrics", ())}
    return list(map(Metric.from_dict, found.values()))


def truth_absences(runs: Sequence[Run]) -> list[str]:
    """Return a sentence on the metrics that runs without ground truth lack, as a list; [] if all runs have it."""
    without = [run for run in runs if not run.has_truth]
    if not without:
        return []
    where = "" if len(without) == len(runs) else f" in {len(without)} of {pluralised(len(runs), 'run')}"
    names = ", ".join(metric.label for metric in standard.STANDARD)
    return [f"No ground truth{where}: {names} and collisions are not measured."]


def own_absences(runs: Sequence[Run]) -> list[str]:
    """Return one text per user's metric that is not defined in some runs, with the reason."""
    texts = []
    for metric in own_metrics(runs):
        reasons = [reason_of(run, metric.name) for run in runs if value_of(run, metric.name) is None]
        if reasons:
            reason = next(filter(None, reasons), "not measured there")
            texts.append(f"{metric.name}: n/a in {len(reasons)} of {pluralised(len(runs), 'run')}, {reason}")
    return texts


def invalid_choices(runs: Sequence[Run]) -> list[str]:
    """Return a sentence per policy that chose rows without a candidate; each choice costs a frame without movement."""
    counts: dict[str, list[int]] = {}
    for run in runs:
        counts.setdefault(run.policy, []).append(int(run.metrics["metrics"].get("invalid_actions") or 0))
    return [
        f"{policy} chose {pluralised(sum(own), 'row')} without a candidate in {sum(map(bool, own))} of "
        f"{pluralised(len(own), 'run')}; each cost a frame without movement."
        for policy, own in counts.items()
        if any(own)
    ]


def overview_columns(runs: Sequence[Run]) -> list[Column]:
    """Return the columns of the overview: metrics, the users' own metrics of these runs, and costs."""
    own = map(Column.of, own_metrics(runs))
    quality = [column for column in COLUMNS if column.best is not None]
    return [*quality, *own, *COLUMNS[len(quality) :]]


def quality_columns(runs: Sequence[Run]) -> list[Column]:
    """Return the columns of quality metrics with a value in at least one run; the users' own metrics are last."""
    return measured([*QUALITY, *map(Column.of, own_metrics(runs))], runs)


def value_of(run: Run, key: str) -> float | None:
    """Return the value of the column ``key`` in a run; None if it is not defined or was not measured."""
    stages = {
        "planning_seconds": PLANNING,
        "mapping_seconds": MAPPING,
        "world_seconds": WORLD,
        "sensor_seconds": ("sensor",),
    }
    if "/" in key:
        protocol, _, name = key.partition("/")
        found = run.protocols.get(protocol)
        return None if found is None else found["metrics"].get(name)
    if key == "seconds":
        return run.timing["total"]
    if key in stages:
        return sum(run.timing.get("seconds", {}).get(stage, 0.0) for stage in stages[key])
    if key == "ended_frame":
        legs = run.trajectory.get("legs")
        return None if legs is None else ended_frame(legs, run.config["configuration"]["frame_budget"])
    metrics = run.metrics["metrics"]
    if key.startswith(LOWER_BOUND):
        if metrics.get("observed_area") is None:
            return None
        name = key.removeprefix(LOWER_BOUND)
        return run.config["configuration"]["frame_budget"] if is_lower_bound(run, key) else metrics[name]
    if key == "lpips" and metrics.get(key) is None:  # `asg evaluate` may have measured LPIPS after the run
        return run.numbers.get(key)
    return metrics.get(key)


def is_lower_bound(run: Run, key: str) -> bool:
    """Return whether the column ``key`` shows the budget as a lower bound, since the run did not reach the level."""
    return key.startswith(LOWER_BOUND) and run.metrics["metrics"].get(key.removeprefix(LOWER_BOUND)) is None


def ratios_text(run: Run) -> str:
    """Return the ratios of a run as text: ``C.R. 82.5 %, C.R. surface 76.3 %, observed –`` (a dash if missing).

    Without ground truth the text has the known volume and the PSNR of keyframes.
    """
    parts = []
    for column in RATIOS if run.has_truth else map(Column.of, WITHOUT_TRUTH):
        value = value_of(run, column.key)
        text = "–" if value is None else f"{value:.{column.digits}f} {column.unit}"
        parts.append(f"{column.header} {text}")
    return ", ".join(parts)


@dataclass(frozen=True)
class Aspect:
    """Hold the columns of one kind of measurement: of a protocol, or of the TSDF surface."""

    name: str  # suffix of the files of its tables; empty for the runs' own protocol
    title: str
    columns: tuple[Column, ...]  # columns with a value in at least one run

    def of(self, table: str) -> str:
        """Return the file name of the table ``table`` for this aspect, without extension."""
        return f"{table}-{slug(self.name)}" if self.name else table


def aspects(runs: Sequence[Run]) -> list[Aspect]:
    """Return the aspects with a value: the runs' own protocol, its TSDF surface, and each further protocol.

    A further protocol that trains a map of its own has columns with the sizes of that map.
    """
    surface = tuple(replace(column, key=f"tsdf_{column.key}") for column in map(Column.of, standard.SURFACE))
    own = runs[0].job.conditions.protocol.name
    found = [Aspect("", own, tuple(quality_columns(runs)))]
    found.append(Aspect("tsdf", f"{own}, TSDF surface", tuple(measured(surface, runs))))
    others = dict.fromkeys(name for run in runs for name in run.protocols if name != own)
    for name in others:
        columns = tuple(replace(column, key=f"{name}/{column.key}") for column in (*QUALITY, *_SIZES))
        found.append(Aspect(name, name, tuple(measured(columns, runs))))
    return [aspect for aspect in found if aspect.columns]


def chosen_columns(keys: Sequence[str], runs: Sequence[Run]) -> Aspect:
    """Return the columns with these keys as one aspect; raise `InputError` for an unknown key.

    The headings of columns of the TSDF surface and of further protocols name it, as in "PSNR, offline".
    """
    named = [(aspect.name, column) for aspect in aspects(runs) for column in aspect.columns]
    everything = [replace(column, header=f"{column.header}, {name}") for name, column in named if name]
    everything += [*COLUMNS, *QUALITY, *PROGRESS, *COSTS, *map(Column.of, own_metrics(runs))]
    known = {column.key: column for column in everything}
    if unknown := [key for key in keys if key not in known]:
        raise unknown_name("column", unknown[0], known)
    return Aspect("chosen", "chosen columns", tuple(known[key] for key in keys))


def reason_of(run: Run, key: str) -> str:
    """Return the reason why the value of the column ``key`` is not defined in a run; empty if none is recorded."""
    protocol, _, name = key.rpartition("/")
    for own in run.metrics.get("own_metrics", ()):
        if own["name"] == key:
            return str(own.get("reason", ""))
    content = run.protocols.get(protocol or run.job.conditions.protocol.name)
    notes = content["metrics"].get("notes") or {} if content else {}
    return notes.get(name) or notes.get(name.partition("_")[0], "")


def measured(columns: Iterable[Column], runs: Sequence[Run]) -> list[Column]:
    """Return those ``columns`` that have a value in at least one run; a lower bound does not count as a value."""
    return [
        column
        for column in columns
        if any(value_of(run, column.key) is not None and not is_lower_bound(run, column.key) for run in runs)
    ]


def unreached_levels_text(runs: Sequence[Run]) -> str:
    """Return a sentence on the shares of the surface that no run has observed; empty if there are none."""
    known = [run for run in runs if run.metrics["metrics"].get("observed_area") is not None]
    keys = [(level, f"{LOWER_BOUND}frames_to_{level}") for level in LEVELS]
    levels = [f"{level} %" for level, key in keys if known and all(is_lower_bound(run, key) for run in known)]
    return f"No run observed {' or '.join(levels)} of the surface" if levels else ""
