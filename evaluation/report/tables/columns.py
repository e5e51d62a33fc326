"""Describe metrics as columns of tables: header, unit, digits and the better direction."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.archive.jobs import slug
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.metrics.planning import LEVELS
from activestructure_gym.evaluation.protocols.metrics import Metric, standard
from activestructure_gym.evaluation.protocols.metrics.base import Best

# Stages of timing.json whose sums are the columns of seconds; `sensor` and `loading` belong to the simulator.
PLANNING = ("planning", "features", "policy")
MAPPING = ("mapping",)
WORLD = ("volume", "planes")


@dataclass(frozen=True)
class Column:
    """Hold the description of one metric of a run."""

    key: str  # field of metrics.json, "PROTOCOL/FIELD" for further protocols, or a column of seconds below
    header: str
    unit: str
    digits: int
    best: Best | None = None  # None for costs and sizes, which have no best value
    meaning: str = ""  # definition, shown as a tooltip

    @property
    def arrow(self) -> str:
        """Return an arrow towards better values; empty for a cost."""
        return {"lowest": "↓", "highest": "↑", None: ""}[self.best]

    @property
    def title(self) -> str:
        """Return header, unit and arrow."""
        return " ".join(part for part in (self.header, f"({self.unit})" if self.unit else "", self.arrow) if part)

    @property
    def tie(self) -> float:
        """Return half a unit of the last printed digit; values that differ by at most this are ties."""
        return 0.5 * 10.0**-self.digits

    @property
    def sign(self) -> int:
        """Return -1 if smaller is better, else 1."""
        return -1 if self.best == "lowest" else 1

    @classmethod
    def of(cls, metric: Metric) -> Column:
        """Return the column of a metric."""
        meaning = metric.meaning.replace("{near}", "the distance threshold")
        return cls(metric.name, metric.label, metric.unit, metric.digits, metric.best, meaning)


# C.R. of the Gaussians' means, C.R. of the TSDF surface, and observed share.
RATIOS = tuple(map(Column.of, (standard.RATIO, standard.TSDF_RATIO, standard.OBSERVED)))
_EXPLORATION = Column(
    "observed_area", "exploration", "%", 1, "highest", "mean observed share of the surface over the frame budget"
)

# Columns of the overview.
COLUMNS = (
    *map(Column.of, (standard.ACCURACY, standard.COMPLETION)),
    *RATIOS,
    *map(Column.of, (standard.PRECISION, standard.PSNR, standard.SSIM)),
    Column("frames", "frames", "", 0),
    Column("metres", "path", "m", 1),
    Column("seconds", "time", "s", 1),
)

# Metrics of the paper's Tables 1 to 3, in their order; metrics that no run has are left out of tables.
QUALITY = tuple(map(Column.of, standard.STANDARD))

# Speed of exploration, and improvement in the second half of the budget; see `metrics.planning`.
LOWER_BOUND = "least_"  # prefix of numbers of frames: the frame budget, a lower bound, if the level was not reached
PROGRESS = (
    *(Column(f"{LOWER_BOUND}frames_to_{level}", f"frames to {level} %", "", 0, "lowest") for level in LEVELS),
    _EXPLORATION,
    Column("late_psnr_rate", "late PSNR", "dB / 100 frames", 2, "highest"),
    Column("late_depth_rate", "late Depth", "cm / 100 frames", 2, "lowest"),
)

COSTS = (
    Column("frames", "frames", "", 0),
    Column("metres", "path", "m", 1),
    Column("decisions", "decisions", "", 0),
    Column("keyframes", "keyframes", "", 0),
    Column("gaussians", "Gaussians", "", 0),
    Column("collisions", "collisions", "", 0),
    Column("planning_seconds", "planning", "s", 1),
    Column("mapping_seconds", "mapping", "s", 1),
    Column("world_seconds", "volume, planes", "s", 1),
    Column("sensor_seconds", "sensor", "s", 1),
    Column("seconds", "total", "s", 1),
)

# Metrics of the cards and of the charts of differences. Acc and Prec. are left out, since a policy that maps little
# has the best values of both.
MAIN = (RATIOS[2], _EXPLORATION, RATIOS[0], Column.of(standard.PSNR), Column.of(standard.DEPTH))


def own_metrics(runs: Sequence[Run]) -> list[Metric]:
    """Return the metrics that users added to the runs' protocols."""
    found = {one["name"]: one for run in runs for one in run.metrics.get("own_metrics", ())}
    return list(map(Metric.from_dict, found.values()))


def own_absences(runs: Sequence[Run]) -> list[str]:
    """Return one sentence per added metric that is not defined in some runs, with the reason."""
    texts = []
    for metric in own_metrics(runs):
        reasons = [reason_of(run, metric.name) for run in runs if value_of(run, metric.name) is None]
        if reasons:
            texts.append(f"{metric.name}: n/a in {len(reasons)} of {pluralised(len(runs), 'run')}, {reasons[0]}")
    return texts


def overview_columns(runs: Sequence[Run]) -> list[Column]:
    """Return the columns of the overview; added metrics precede the costs."""
    own = map(Column.of, own_metrics(runs))
    quality = [column for column in COLUMNS if column.best is not None]
    return [*quality, *own, *COLUMNS[len(quality) :]]


def quality_columns(runs: Sequence[Run]) -> list[Column]:
    """Return the columns of quality with a value in at least one run; added metrics are last."""
    return measured([*QUALITY, *map(Column.of, own_metrics(runs))], runs)


def value_of(run: Run, key: str) -> float | None:
    """Return a run's value of a column; None if it is not defined or was not measured."""
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
    metrics = run.metrics["metrics"]
    if key.startswith(LOWER_BOUND):
        if metrics.get("observed_area") is None:
            return None
        name = key.removeprefix(LOWER_BOUND)
        return run.config["configuration"]["frame_budget"] if is_lower_bound(run, key) else metrics[name]
    if key == "lpips" and metrics.get(key) is None:  # `asg evaluate` may have measured it later
        return run.numbers.get(key)
    return metrics.get(key)


def is_lower_bound(run: Run, key: str) -> bool:
    """Return whether the level was not reached, so the column shows the budget as a lower bound."""
    return key.startswith(LOWER_BOUND) and run.metrics["metrics"].get(key.removeprefix(LOWER_BOUND)) is None


def ratios_text(run: Run) -> str:
    """Return a text such as ``C.R. 82.5 %, C.R. surface 76.3 %, observed 91.0 %``, with a dash for missing values."""
    parts = []
    for column in RATIOS:
        value = value_of(run, column.key)
        parts.append(f"{column.header} –" if value is None else f"{column.header} {value:.{column.digits}f} %")
    return ", ".join(parts)


@dataclass(frozen=True)
class Aspect:
    """Hold the columns of one protocol, or of the TSDF surface."""

    name: str  # suffix of its tables' files; empty for the runs' own protocol
    title: str
    columns: tuple[Column, ...]  # columns with a value in at least one run

    def of(self, table: str) -> str:
        """Return the file name of a table of this aspect."""
        return f"{table}-{slug(self.name)}" if self.name else table


def aspects(runs: Sequence[Run]) -> list[Aspect]:
    """Return the aspects of the runs' own protocol, of its TSDF surface if measured, and of each further protocol."""
    surface = tuple(replace(column, key=f"tsdf_{column.key}") for column in map(Column.of, standard.SURFACE))
    own = runs[0].job.conditions.protocol.name
    found = [Aspect("", own, tuple(quality_columns(runs)))]
    found.append(Aspect("tsdf", f"{own}, TSDF surface", tuple(measured(surface, runs))))
    others = dict.fromkeys(name for run in runs for name in run.protocols if name != own)
    for name in others:
        columns = tuple(replace(column, key=f"{name}/{column.key}") for column in QUALITY)
        found.append(Aspect(name, name, tuple(measured(columns, runs))))
    return [aspect for aspect in found if aspect.columns]


def reason_of(run: Run, key: str) -> str:
    """Return the protocol's reason why a value is not defined; empty if it gives none."""
    protocol, _, name = key.rpartition("/")
    for own in run.metrics.get("own_metrics", ()):
        if own["name"] == key:
            return str(own.get("reason", ""))
    content = run.protocols.get(protocol or run.job.conditions.protocol.name)
    notes = content["metrics"].get("notes") or {} if content else {}
    return notes.get(name) or notes.get(name.partition("_")[0], "")


def measured(columns: Iterable[Column], runs: Sequence[Run]) -> list[Column]:
    """Return the columns with a value in at least one run; a lower bound does not count as a value."""
    return [
        column
        for column in columns
        if any(value_of(run, column.key) is not None and not is_lower_bound(run, column.key) for run in runs)
    ]


def unreached_levels_text(runs: Sequence[Run]) -> str:
    """Return a sentence with the shares of the surface that no run observed; empty if all were reached."""
    known = [run for run in runs if run.metrics["metrics"].get("observed_area") is not None]
    keys = [(level, f"{LOWER_BOUND}frames_to_{level}") for level in LEVELS]
    levels = [f"{level} %" for level, key in keys if known and all(is_lower_bound(run, key) for run in known)]
    return f"No run observed {' or '.join(levels)} of the surface" if levels else ""
