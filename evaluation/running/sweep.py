"""Check the sweep of a comparison, which varies configuration fields, and combine its values with the conditions."""

from __future__ import annotations

import itertools
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, value_text
from activestructure_gym.evaluation.archive.json_files import plain

if TYPE_CHECKING:
    from activestructure_gym.config import ReconstructionConfig
    from activestructure_gym.specs import Spec

# Fields of the sensor that an episode in a world does not use.
_CAMERA = (
    "sensor", "sensor.width", "sensor.height", "sensor.horizontal_fov_deg", "sensor.intrinsics", "sensor.supersample",
    "sensor.backend",
)  # fmt: skip


def checked_sweep(sweep: Mapping[str, Any], conditions: Conditions) -> dict[str, tuple[Any, ...]]:
    """Return the values of each swept field without types of NumPy, and 1 for 1.0, so that equal values are one job.

    Raise `InputError` for a field that ``conditions`` set as well, and for missing or repeated values.
    """
    if not isinstance(sweep, Mapping):
        raise InputError(f"a sweep has values by field, as {{'mapper.iterations': [5, 10]}}, got {short_repr(sweep)}")
    checked: dict[str, tuple[Any, ...]] = {}
    for name, values in dict(sweep).items():
        if name in conditions.overrides or (name == "frame_budget" and conditions.frame_budget is not None):
            raise InputError(f"{name} is swept and also set to one value for all runs: leave one of the two out")
        if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or not len(values):
            raise InputError(f"the sweep of {name} is a list of values, as [1, 2], got {short_repr(values)}")
        whole = [int(one) if isinstance(one, float) and one.is_integer() else one for one in plain(list(values))]
        checked[name] = tuple(whole)
        if len(_distinct(checked[name])) < len(values):
            raise InputError(f"the sweep of {name} has a value twice: {', '.join(map(value_text, checked[name]))}")
    return checked


def refuse_camera(sweep: Collection[str], world: str) -> None:
    """Raise `InputError` if a swept field describes the simulated camera: the ``world`` has a camera of its own."""
    if found := [name for name in sweep if name in _CAMERA]:
        raise InputError(f"{found[0]} is swept, and '{world}' has a camera of its own: sweep it in scenes only")


def check_effect(policy: Spec, configurations: Sequence[ReconstructionConfig]) -> None:
    """Raise `InputError` if the configurations of a policy, one for each combination of swept values, are not distinct.

    Its rows in the tables would differ in name only.
    """
    if len(set(configurations)) < len(configurations):
        raise InputError(
            f"two combinations of swept values give '{policy}' the same configuration: a swept field is set by the "
            "policy or by another option, such as --set; leave it out of the sweep"
        )


def combinations(sweep: Mapping[str, Sequence[Any]], conditions: Conditions) -> list[Conditions]:
    """Return the conditions with each combination of swept values; without a sweep, the conditions alone."""
    return [
        replace(conditions, overrides={**conditions.overrides, **dict(zip(sweep, values))})
        for values in itertools.product(*sweep.values())
    ]


def sweep_of(jobs: Sequence[Job]) -> dict[str, tuple[Any, ...]]:
    """Return the values of each swept field in the jobs of a comparison, in the order of the jobs."""
    values = [job.swept_values for job in jobs]
    return {name: _distinct([own[name] for own in values if name in own]) for name in jobs[0].swept}


def _distinct(values: Sequence[Any]) -> tuple[Any, ...]:
    """Return the values without repetitions; True and 1 are different."""
    return tuple({json.dumps(value): value for value in values}.values())
