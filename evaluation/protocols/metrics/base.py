"""Define a metric, the context that it is computed from, and the registry of metrics."""

from __future__ import annotations

import dataclasses
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from activestructure_gym.errors import InputError, InputWarning, short_repr
from activestructure_gym.registry import Registry

if TYPE_CHECKING:
    from activestructure_gym.evaluation.protocols.base import CameraPath
    from activestructure_gym.evaluation.protocols.standard import StandardProtocol, Truth
    from activestructure_gym.ground_truth import GroundTruth
    from activestructure_gym.mapping import GaussianMap

Best = Literal["lowest", "highest"]
_MAX_DIGITS = 12  # maximum number of digits after the decimal point in tables
_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class MetricContext:
    """Hold everything that a metric may read of a finished run.

    Attributes
    ----------
    gaussians
        The map.
    truth
        ``surface`` (samples of the true surface) and ``views`` (held-out views) of the protocol.
    ground_truth
        ``scene`` with its mesh, and ``free_space``.
    protocol
        ``points(gaussians)`` returns the reconstructed points, ``picture(gaussians, truth, index)`` a rendered view.
    path
        Camera, ``keyframes`` [K, 4, 4], range in metres.
    trajectory
        [T, 4, 4] ``world_from_camera`` of every frame.
    numbers
        The numbers of the protocol and of the episode by name.
    """

    gaussians: GaussianMap
    truth: Truth
    ground_truth: GroundTruth
    protocol: StandardProtocol
    path: CameraPath
    trajectory: np.ndarray
    numbers: Mapping[str, Any]


@dataclass(frozen=True)
class Metric:
    """Describe a number of a finished run: its function, and its column in tables.

    Parameters
    ----------
    name
        Key in ``metrics.json``: lower-case letters, digits and underscores.
    best
        Whether the ``"lowest"`` or the ``"highest"`` value is the best.
    label
        Heading in tables. Default: the name.
    unit
        Unit in tables, for example ``"cm"``.
    digits
        Digits after the decimal point in tables. Values that are printed equally count as equal.
    meaning
        Explanation in the report.
    compute
        Function of a `MetricContext` that returns a number, or None if the metric is undefined. A metric that a
        protocol measures has no function.
    """

    name: str
    best: Best
    label: str = ""
    unit: str = ""
    digits: int = 2
    meaning: str = ""
    compute: Callable[[MetricContext], float | None] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise InputError(
                f"a metric's name has lower-case letters, digits and underscores, got {short_repr(self.name)}"
            )
        if self.best not in get_args(Best):
            raise InputError(f"best of the metric '{self.name}' is lowest or highest, got {short_repr(self.best)}")
        if not isinstance(self.digits, int) or not 0 <= self.digits <= _MAX_DIGITS:
            raise InputError(
                f"digits of the metric '{self.name}' is a whole number from 0 to {_MAX_DIGITS}, got {self.digits}"
            )
        object.__setattr__(self, "label", self.label or self.name)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Metric:
        """Create the metric from ``content``, the result of `as_dict`; it has no function."""
        return cls(**{field.name: content[field.name] for field in dataclasses.fields(cls) if field.name != "compute"})

    def as_dict(self) -> dict[str, Any]:
        """Return all fields except the function for ``metrics.json``."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "compute"}


METRICS: Registry[Metric] = Registry(
    "metric",
    "metrics",
    fits=lambda entry: isinstance(entry, Metric),
    wanted="a Metric",
    files=("evaluation/protocols/metrics/*.py",),
)


def get_metric(name: str) -> Metric:
    """Return a metric that is computed in addition to those of the protocol.

    ``name`` is a registered name or ``"package.module:NAME"``. Raise `InputError` for an unknown name, and for a metric
    that every run has already.
    """
    metric = METRICS.get(name)
    if metric.compute is None:
        raise InputError(f"every run has the metric '{name}' already: leave it out")
    if metric.name in METRICS and METRICS.get(metric.name) is not metric:
        raise InputError(f"metric '{name}' is called '{metric.name}', which is another metric: rename it")
    return metric


def get_metrics(names: Sequence[str]) -> list[Metric]:
    """Return the metrics with these names, see `get_metric`.

    Raise `InputError` for a name that `get_metric` refuses, and for two metrics that share a key in ``metrics.json``.
    """
    found = dict[str, tuple[str, Metric]]()
    for name in names:
        metric = get_metric(name)
        first, other = found.setdefault(metric.name, (name, metric))
        if other is not metric:
            raise InputError(f"metrics '{first}' and '{name}' are both called '{metric.name}': rename one of them")
    return [metric for _, metric in found.values()]


def added_metrics(names: Sequence[str], numbers: Mapping[str, Any]) -> list[Metric]:
    """Return the named metrics that a run with these ``numbers`` gets in addition.

    A metric with the name of another number of the run is left out with an `InputWarning`.
    """
    added = dict[str, Metric]()
    for metric in map(get_metric, names):
        if metric.name in numbers or metric.name in added:
            text = f"metric '{metric.name}' is left out, since the run has another number of that name: rename it"
            warnings.warn(text, InputWarning, stacklevel=3)
        else:
            added[metric.name] = metric
    return list(added.values())


def measure_metrics(
    names: Sequence[str], context: MetricContext
) -> tuple[dict[str, float | None], list[dict[str, Any]]]:
    """Compute the named metrics of a finished run, see `added_metrics`.

    Return two results: the values by metric name, and the descriptions of the metrics for ``metrics.json``. An
    undefined metric has the value None, and its description has a ``reason``.
    """
    values: dict[str, float | None] = {}
    described = list[dict[str, Any]]()
    for metric in added_metrics(names, context.numbers):
        assert metric.compute is not None
        reason = "it is not defined for this map"
        try:
            found = metric.compute(context)
            value = None if found is None else float(found)
        except Exception as error:  # an error in the metric's code must not lose a played run
            value, reason = None, " ".join(f"{type(error).__name__}: {error}".split())
        if value is not None and not math.isfinite(value):
            value, reason = None, f"its value is {value}"
        values[metric.name] = value
        described.append(metric.as_dict() | ({"reason": reason} if value is None else {}))
    return values, described
