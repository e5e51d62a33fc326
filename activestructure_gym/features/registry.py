"""Register features by name, and evaluate them for the candidates of a step."""

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
    """Hold a feature: a function of a `FeatureContext`, with names, units and ranges of its columns.

    Parameters
    ----------
    compute : callable
        ``compute(context)`` returns [K] finite numbers, one for each candidate, or [K, C] with C columns.
    columns : iterable of str
        Names of the columns. The full name of a column is ``<feature>_<column>``; the column ``""`` has the name of
        the feature.
    unit : str or iterable of str
        Unit of all columns, or one per column: ``m``, ``deg^2``, ``share of the image``, ``index``, ``0 or 1``.
    low, high : float or iterable of float
        Smallest and largest possible value of all columns, or one per column.

    Raises
    ------
    InputError
        There is no column, two have the same name, or the number of units or bounds does not fit.
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
            raise InputError(f"columns of a feature must be one or more different texts, got {short_repr(columns)}")
        self.units: tuple[str, ...] = self._each("unit", unit, isinstance(unit, str))
        self.low: tuple[float, ...] = self._each("low", low, isinstance(low, int | float))
        self.high: tuple[float, ...] = self._each("high", high, isinstance(high, int | float))

    def _each(self, what: str, value: Any, same: bool) -> tuple[Any, ...]:
        values = (value,) * len(self.columns) if same else tuple(value)
        if len(values) != len(self.columns):
            raise InputError(f"{what} of a feature must be one value, or one per column, got {short_repr(value)}")
        return values

    def __call__(self, context: FeatureContext) -> np.ndarray:  # [K] or [K, C]
        """Return ``compute(context)``, without the checks of `evaluate_features`."""
        return self.compute(context)


class FeatureRegistry(Registry[Feature]):
    """Register features by name, and find the feature that has a column of a given full name."""

    def register(  # type: ignore[override]
        self,
        name: str,
        *,
        columns: Iterable[str] = ("",),
        unit: str | Iterable[str] = "-",
        low: float | Iterable[float] = -np.inf,
        high: float | Iterable[float] = np.inf,
    ) -> Callable[[Compute], Feature]:
        """Return a decorator that registers a function as the feature ``name``; the keywords are those of `Feature`."""
        keep, names = super().register(name), tuple(columns)
        return lambda compute: keep(Feature(compute, columns=names, unit=unit, low=low, high=high))

    def get(self, name: str) -> Feature:
        """Return the feature ``name``; a plain function ``package.module:function`` becomes a feature of one column."""
        found = super().get(name)
        return found if isinstance(found, Feature) else Feature(found)

    def module_of(self, name: str) -> str | None:
        """Return the module that defines ``name``, a feature or the full name of a column; None if it is unknown."""
        for owner in (name, *_beginnings(name)):
            if (module := super().module_of(owner)) or owner in self._entries:
                return module
        return None

    def columns(self, name: str) -> tuple[str, ...]:
        """Return the full names of a feature's columns; raise `InputError` for an unknown feature."""
        return tuple(f"{name}_{column}" if column else name for column in self.get(name).columns)

    def owner(self, asked: str) -> str:
        """Return the name of the feature with the name ``asked``, or with a column of this full name.

        Raise `InputError` if there is no such feature or column.
        """
        names = [asked, *_beginnings(asked)] if isinstance(asked, str) else []
        loaded = [name for name in names if name in self._entries]
        for name in (*loaded, *names):  # names that must be imported come last
            with suppress(InputError):
                if asked in (name, *self.columns(name)):
                    return name
        self.get(asked)  # raises the error with suggestions
        raise InputError(f"there is no feature {short_repr(asked)}")

    def expanded(self, asked: str) -> tuple[str, ...]:
        """Return the full names of the columns that ``asked`` means: all of a feature, or the column of this name.

        Raises `InputError` if there is neither, and if two features have a column of the same name.
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
    """Return the beginnings of a column's full name that can be its feature: ``a_b`` and ``a`` for ``a_b_c``."""
    return [column[:place] for place in range(len(column) - 1, 0, -1) if column[place] == "_"]


def column_names(asked: Iterable[str]) -> tuple[str, ...]:
    """Return the full names of the requested columns, in order, without duplicates.

    Parameters
    ----------
    asked : iterable of str
        Names of features, each of which means all its columns, or full names of columns.

    Returns
    -------
    tuple of str
        The G full names.

    Raises
    ------
    InputError
        A name is neither the name of a feature nor the full name of a column.
    """
    return tuple(dict.fromkeys(name for each in asked for name in FEATURES.expanded(each)))


def evaluate_features(asked: Iterable[str], context: FeatureContext) -> np.ndarray:  # [K, G] float32
    """Compute the columns named by `column_names`; each feature is computed once.

    Parameters
    ----------
    asked : iterable of str
        Names of features or full names of columns.
    context : FeatureContext
        The reconstruction and its K candidates.

    Returns
    -------
    ndarray
        [K, G] float32, one row per candidate and one column per name.

    Raises
    ------
    InputError
        A name is unknown, or a feature returns values that are not finite or have the wrong shape.
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
