"""Metrics as columns of tables: header, unit, digits, and which direction is better."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from activestructure_gym.errors import pluralised
from activestructure_gym.evaluation.archive.jobs import slug
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.metrics.planning import LEVELS
from activestructure_gym.evaluation.protocols.metrics import Metric, standard
from activestructure_gym.evaluation.protocols.metrics.base import Best

# Stages of timing.json that make up the columns of seconds; `sensor` and `loading` belong to the simulator.
PLANNING = ("planning", "features", "policy")
MAPPING = ("mapping",)
WORLD = ("volume", "planes")


@dataclass(frozen=True)
class Column:
    """One metric of a run."""

    key: str  # in metrics.json, "PROTOCOL/KEY" of a further protocol's numbers, or one of the seconds below
    header: str
    unit: str
    digits: int
    best: Best | None = None  # None: a cost or a size that has no best

    @property
    def arrow(self) -> str:
        """Arrow towards better values; empty for a cost."""
        return {"lowest": "↓", "highest": "↑", None: ""}[self.best]

    @property
    def title(self) -> str:
        """Header, unit and arrow."""
        return " ".join(part for part in (self.header, f"({self.unit})" if self.unit else "", self.arrow) if part)

    @property
    def tie(self) -> float:
        """Half a unit of the last printed digit: values that differ by no more are ties."""
        return 0.5 * 10.0**-self.digits

    @property
    def sign(self) -> int:
        """-1 where smaller is better, else 1."""
        return -1 if self.best == "lowest" else 1

    @classmethod
    def of(cls, metric: Metric) -> Column:
        """Return the column of a metric."""
        return cls(metric.name, metric.label, metric.unit, metric.digits, metric.best)


# How much was seen and how much of it is mapped: C.R. of the means, of the TSDF surface, and what any keyframe saw.
RATIOS = tuple(map(Column.of, (standard.RATIO, standard.TSDF_RATIO, standard.OBSERVED)))
_EXPLORATION = Column("observed_area", "exploration", "%", 1, "highest")

# The overview's: one line per scene and policy.
COLUMNS = (
    *map(Column.of, (standard.ACCURACY, standard.COMPLETION)),
    *RATIOS,
    *map(Column.of, (standard.PRECISION, standard.PSNR, standard.SSIM)),
    Column("frames", "frames", "", 0),
    Column("metres", "path", "m", 1),
    Column("seconds", "time", "s", 1),
)

# Everything the paper's Tables 1 to 3 may hold, in their order; what no run has is left out.
QUALITY = tuple(map(Column.of, standard.STANDARD))

# How soon the surface was seen, and what late frames were worth; see `metrics.planning`.
LOWER_BOUND = "least_"  # before the name of a number of frames: where the budget was too small, the budget
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
    Column("seconds", "whole", "s", 1),
)

# The metrics of the cards and of the comparison with the baseline. Acc and Prec. are not among them: a policy that
# maps little has the best of both.
MAIN = (RATIOS[2], _EXPLORATION, RATIOS[0], Column.of(standard.PSNR), Column.of(standard.DEPTH))


def own_metrics(runs: Sequence[Run]) -> list[Metric]:
    """Return the metrics that the runs were measured by besides their protocols."""
    found = {one["name"]: one for run in runs for one in run.metrics.get("own_metrics", ())}
    return list(map(Metric.from_dict, found.values()))


def own_absences(runs: Sequence[Run]) -> list[str]:
    """Return a sentence for every own metric that is not defined in some run, with the reason."""
    texts = []
    for metric in own_metrics(runs):
        reasons = [reason_of(run, metric.name) for run in runs if value_of(run, metric.name) is None]
        if reasons:
            texts.append(f"{metric.name}: n/a in {len(reasons)} of {pluralised(len(runs), 'run')}, {reasons[0]}")
    return texts


def overview_columns(runs: Sequence[Run]) -> list[Column]:
    """Return the columns of the overview, those of the runs' own metrics before the costs."""
    own = map(Column.of, own_metrics(runs))
    quality = [column for column in COLUMNS if column.best is not None]
    return [*quality, *own, *COLUMNS[len(quality) :]]


def quality_columns(runs: Sequence[Run]) -> list[Column]:
    """Return the columns of quality that at least one run has a number for, those of the runs' own metrics last."""
    return measured([*QUALITY, *map(Column.of, own_metrics(runs))], runs)


def value_of(run: Run, key: str) -> float | None:
    """A run's number; None where it is not defined or was not measured."""
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
        return run.config["configuration"]["frame_budget"] if exceeded(run, key) else metrics[name]
    if key == "lpips" and metrics.get(key) is None:  # it may have been measured later
        return run.numbers.get(key)
    return metrics.get(key)


def exceeded(run: Run, key: str) -> bool:
    """Whether a number of frames of `PROGRESS` is the budget in place of more than that."""
    return key.startswith(LOWER_BOUND) and run.metrics["metrics"].get(key.removeprefix(LOWER_BOUND)) is None


def ratios_text(run: Run) -> str:
    """``C.R. 82.5 %, of the surface 76.3 %, observed 91.0 %``; a dash for what was not measured."""
    parts = []
    for name, column in zip(("C.R.", "of the surface", "observed"), RATIOS):
        value = value_of(run, column.key)
        parts.append(f"{name} –" if value is None else f"{name} {value:.{column.digits}f} %")
    return ", ".join(parts)


@dataclass(frozen=True)
class Aspect:
    """Metrics of the same maps under one protocol, or of its TSDF surface."""

    name: str  # of its tables' files; empty for the run's own protocol
    title: str
    columns: tuple[Column, ...]  # those that at least one run has a number for

    def of(self, table: str) -> str:
        """File name of this aspect's ``table``."""
        return f"{table}-{slug(self.name)}" if self.name else table


def aspects(runs: Sequence[Run]) -> list[Aspect]:
    """The runs' own protocol, its TSDF surface if there is one, and every further protocol."""
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
    """Why a number is not defined, as far as the protocol said."""
    protocol, _, name = key.rpartition("/")
    for own in run.metrics.get("own_metrics", ()):
        if own["name"] == key:
            return str(own.get("reason", ""))
    content = run.protocols.get(protocol or run.job.conditions.protocol.name)
    notes = content["metrics"].get("notes") or {} if content else {}
    return notes.get(name) or notes.get(name.partition("_")[0], "")


def measured(columns: Iterable[Column], runs: Sequence[Run]) -> list[Column]:
    """Return the columns that at least one run has a number for; of a number of frames, that at least one reached."""
    return [
        column
        for column in columns
        if any(value_of(run, column.key) is not None and not exceeded(run, column.key) for run in runs)
    ]


def unreached(runs: Sequence[Run]) -> str:
    """Return a sentence that names the shares of the surface that no run observed; empty if there is none."""
    known = [run for run in runs if run.metrics["metrics"].get("observed_area") is not None]
    keys = [(level, f"{LOWER_BOUND}frames_to_{level}") for level in LEVELS]
    levels = [f"{level} %" for level, key in keys if known and all(exceeded(run, key) for run in known)]
    return f"No run observed {' or '.join(levels)} of the surface" if levels else ""
