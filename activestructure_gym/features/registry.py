"""Features by name: what is registered, which columns each has, and their values for the candidates of a step."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.features.context import FeatureContext
from activestructure_gym.registry import Registry

Compute = Callable[[FeatureContext], np.ndarray]  # -> [K], or [K, C] with C columns


class Feature:
    """A feature of candidate views: a function of a `FeatureContext`, with names, units and ranges of its columns.

    Parameters
    ----------
    compute : callable
        ``compute(context)`` returns [K] finite numbers, one for each candidate, or [K, C] with C columns.
    columns : iterable of str
        Names of the columns. In full a column is called ``<feature>_<column>``, and the one named ``""`` like the
        feature.
    unit : str or iterable of str
        Of all columns, or of each: ``m``, ``deg^2``, ``share of the image``, ``index``, ``0 or 1``.
    low, high : float or iterable of float
        Between which values lie, of all columns or of each.

    Raises
    ------
    InputError
        No column, two of the same name, or units or bounds of another number of columns.
    """

    def __init__(
        self,
        compute: Compute,
        *,
        columns: Iterable[str] = ("",),
        unit: str | Iterable[str] = "-",
        low: float | Iterable[float] = -np.inf,
        high: float | Iterable[float] = np.inf,
    ) -> None:
        functools.update_wrapper(self, compute)
        self.compute, self.columns = compute, tuple(columns)
        count = len(self.columns)
        if not count or len(set(self.columns)) < count or not all(isinstance(name, str) for name in self.columns):
            raise InputError(
                f"columns of a feature are texts, all different and at least one, got {short_repr(columns)}"
            )
        self.units: tuple[str, ...] = self._each("unit", unit, isinstance(unit, str))
        self.low: tuple[float, ...] = self._each("low", low, isinstance(low, int | float))
        self.high: tuple[float, ...] = self._each("high", high, isinstance(high, int | float))

    def _each(self, what: str, value: Any, same: bool) -> tuple[Any, ...]:
        values = (value,) * len(self.columns) if same else tuple(value)
        if len(values) != len(self.columns):
            raise InputError(f"{what} of a feature is one for all columns or one for each, got {short_repr(value)}")
        return values

    def __call__(self, context: FeatureContext) -> np.ndarray:  # [K] or [K, C]
        """The values for the candidates of a step, as the function returns them."""
        return self.compute(context)


class FeatureRegistry(Registry[Feature]):
    """The registry of features, which also finds columns by their full names."""

    def register(  # type: ignore[override]
        self,
        name: str,
        *,
        columns: Iterable[str] = ("",),
        unit: str | Iterable[str] = "-",
        low: float | Iterable[float] = -np.inf,
        high: float | Iterable[float] = np.inf,
    ) -> Callable[[Compute], Feature]:
        """Decorator: ``@FEATURES.register("mine", columns=("x", "y"), unit="m")``; keywords as in `Feature`."""
        keep, names = super().register(name), tuple(columns)
        return lambda compute: keep(Feature(compute, columns=names, unit=unit, low=low, high=high))

    def get(self, name: str) -> Feature:
        """The feature called ``name``; a plain function, found as ``package.module:function``, has one column."""
        found = super().get(name)
        return found if isinstance(found, Feature) else Feature(found)

    def module_of(self, name: str) -> str | None:
        """As of any registry, also by a column's full name."""
        for owner in (name, *_beginnings(name)):
            if (module := super().module_of(owner)) or owner in self._entries:
                return module
        return None

    def columns(self, name: str) -> tuple[str, ...]:
        """Full names of a feature's columns. Raises `InputError` for an unknown feature."""
        return tuple(f"{name}_{column}" if column else name for column in self.get(name).columns)

    def owner(self, asked: str) -> str:
        """The feature called ``asked``, else the one that has a column of this full name.

        Raises `InputError` where there is neither.
        """
        names = [asked, *_beginnings(asked)] if isinstance(asked, str) else []
        at_hand = [name for name in names if name in self._entries]
        for name in (*at_hand, *names):  # what has to be imported comes last
            with suppress(InputError):
                if asked in (name, *self.columns(name)):
                    return name
        self.get(asked)  # which says what is wrong with it
        raise InputError(f"there is no feature {short_repr(asked)}")

    def expanded(self, asked: str) -> tuple[str, ...]:
        """The columns of the feature called ``asked``, or the one column of this full name.

        Raises `InputError` where there is neither, and for a feature whose column has the name of another's.
        """
        owner = self.owner(asked)
        names = self.columns(owner) if owner == asked else (asked,)
        for name in names:
            if (other := self.owner(name)) != owner:
                raise InputError(f"'{name}' is a column of the feature '{owner}' and of '{other}': rename one of them")
        return names


FEATURES = FeatureRegistry(
    "feature",
    "features",
    fits=callable,
    wanted="a function of a FeatureContext",
    files=("features/*.py", "policies/*/features.py"),
)


def _beginnings(column: str) -> list[str]:
    """Names of features that could have the column ``a_b_c``: ``a_b`` and ``a``."""
    return [column[:place] for place in range(len(column) - 1, 0, -1) if column[place] == "_"]


def column_names(asked: Iterable[str]) -> tuple[str, ...]:
    """The columns that are asked for, in this order and each once: all of a feature's, or single ones by full name.

    Raises `InputError` for a name that is neither a feature's nor a column's.
    """
    return tuple(dict.fromkeys(name for each in asked for name in FEATURES.expanded(each)))


def evaluate_features(asked: Iterable[str], context: FeatureContext) -> np.ndarray:  # [K, G] float32
    """The columns that `column_names` tells, each feature computed once.

    Raises `InputError` if a feature returns anything but finite numbers, one row for each candidate.
    """
    names = column_names(asked)
    table = np.zeros((len(context.world_from_camera), len(names)), dtype=np.float32)
    if not len(table):
        return table
    values: dict[str, np.ndarray] = {}
    for place, name in enumerate(names):
        owner = FEATURES.owner(name)
        if owner not in values:
            values[owner] = _checked(owner, context)
        table[:, place] = values[owner][:, FEATURES.columns(owner).index(name)]
    return table


def _checked(name: str, context: FeatureContext) -> np.ndarray:  # [K, C] float32
    feature, rows = FEATURES.get(name), len(context.world_from_camera)
    returned = context.once(feature)
    shape = (rows, len(feature.columns))
    each = "one" if shape[1] == 1 else f"{shape[1]} (one per column)"
    wanted = f"feature '{name}' must return {rows * shape[1]} finite numbers, {each} for each candidate, got"
    try:
        values = np.asarray(returned, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"{wanted} {short_repr(returned)}") from error
    if returned is None or values.shape not in ((shape, (rows,)) if shape[1] == 1 else (shape,)):
        came = "nothing" if returned is None else f"an array of the shape {values.shape}"
        raise InputError(f"{wanted} {came}")
    if not np.isfinite(values).all():
        raise InputError(f"{wanted} {int((~np.isfinite(values)).sum())} not finite")
    return values.reshape(shape)
