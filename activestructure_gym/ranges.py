"""Check that the numbers of a configuration are within ranges, written in interval notation: ``[0, 1)``."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Mapping
from functools import cache
from typing import Any

from activestructure_gym.errors import InputError, short_repr

POSE_ROUNDING = 2e-3  # largest accepted entry of R R^T - I; rounding to three decimals gives up to 0.001 sqrt(3)
# Limits of all runs; a configuration beyond them is refused before the first frame.
MAX_COORDINATE_M = 1e6  # metres from the world's origin along each axis
MAX_ASPECT_RATIO = 8  # largest ratio of a camera image's longer to its shorter side
MAX_FRAMES = 10**6  # largest number of frames per episode: all poses are kept in memory


def check_ranges(config: Any, ranges: Mapping[str, str], label: str = "") -> None:
    """Raise `InputError` if a field of the dataclass ``config`` is outside its range.

    ``ranges`` maps field names to intervals. Every entry of a tuple is checked. Infinity and NaN are in no range. None
    is accepted if the field's type allows it. ``label`` precedes the field's name in messages; with ``--`` the name is
    written as an option of the command line.
    """
    kinds = _kinds(config.__class__)
    for name, text in ranges.items():
        value = getattr(config, name)
        whole, many, optional = kinds[name]
        if optional and value is None:
            continue
        interval, called = _interval(text), label + (name.replace("_", "-") if label == "--" else name)
        if many and (not isinstance(value, tuple) or not value):
            raise InputError(f"{called} must be a tuple of at least one number, got {short_repr(value)}")
        for entry in value if many else (value,):
            if not interval.holds(entry, whole=whole):
                kind = "a whole number" if whole else "a number"
                each = f"every entry of {called}" if many else f"{called}"
                raise InputError(f"{each} must be {kind} {interval.words}, got {short_repr(entry)}")


@dataclasses.dataclass(frozen=True)
class _Interval:
    low: float
    high: float
    with_low: bool
    with_high: bool

    def holds(self, value: Any, *, whole: bool) -> bool:
        if isinstance(value, bool) or not isinstance(value, numbers.Integral if whole else numbers.Real):
            return False
        number: Any = value
        above = number >= self.low if self.with_low else number > self.low
        return bool(above and (number <= self.high if self.with_high else number < self.high))

    @property
    def words(self) -> str:
        low = f"{'from' if self.with_low else 'above'} {_number(self.low)}"
        if self.with_low and self.with_high:
            return f"{low} to {_number(self.high)}"
        return (
            f"{low} {'to' if self.with_low else 'and'} {'at most' if self.with_high else 'below'} {_number(self.high)}"
        )


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e16 else f"{value:g}"


@cache
def _interval(text: str) -> _Interval:
    low, high = (float(side) for side in text[1:-1].split(","))
    if text[0] not in "[(" or text[-1] not in "])" or not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(f"a range is written as in [0, 1), got {text!r}")
    return _Interval(low, high, text[0] == "[", text[-1] == "]")


@cache
def _kinds(kind: type) -> dict[str, tuple[bool, bool, bool]]:
    """Return three facts about each field of a dataclass: it holds integers, it is a tuple, it may be None."""
    found = {}
    for field in dataclasses.fields(kind):
        hint = field.type if isinstance(field.type, str) else getattr(field.type, "__name__", str(field.type))
        many = hint.startswith("tuple[")
        found[field.name] = (hint.removeprefix("tuple[").startswith("int"), many, hint.endswith("| None"))
    return found
