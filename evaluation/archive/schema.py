"""Check the content of files: types, ranges, and lengths that must agree.

A check is a function of a value and its place in the file (``metrics.views[3].psnr``). It returns None or raises
`Mismatch`. After a check, required keys exist and numbers are finite. Unknown keys are allowed.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from activestructure_gym.errors import short_repr

Check = Callable[[Any, str], None]

MAX_NUMBER = 1e15  # limit of any number; float64 represents all whole numbers up to here
MAX_JSON_BYTES = 64 << 20  # bytes of a JSON file
_MAX_DEPTH = 32  # levels of nesting
_MAX_TEXT_CHARACTERS = 100_000  # characters


class Mismatch(ValueError):
    """Signal that a file's content is wrong; the message holds the place, the expectation and the value."""


def number(low: float = -MAX_NUMBER, high: float = MAX_NUMBER, *, whole: bool = False) -> Check:
    """Return a check for a finite number in [``low``, ``high``]."""
    kind = "a whole number" if whole else "a number"

    def check(value: Any, place: str) -> None:
        good = isinstance(value, int) if whole else isinstance(value, int | float)
        if not good or isinstance(value, bool) or not low <= value <= high:
            limits = kind if (low, high) == (-MAX_NUMBER, MAX_NUMBER) else f"{kind} from {low:g} to {high:g}"
            raise _mismatch(place, limits, value)

    return check


def text(value: Any, place: str) -> None:
    """Check for a text of at most 100,000 characters."""
    if not isinstance(value, str) or len(value) > _MAX_TEXT_CHARACTERS:
        raise _mismatch(place, "a text", value)


def scalar(value: Any, place: str) -> None:
    """Check for a text, a number, true, false or null."""
    if isinstance(value, str):
        text(value, place)
    elif value is not None and not isinstance(value, bool):
        number()(value, place)


def anything(value: Any, place: str) -> None:
    """Accept any value."""


def flag(value: Any, place: str) -> None:
    """Check for true or false."""
    if not isinstance(value, bool):
        raise _mismatch(place, "true or false", value)


def maybe(check: Check) -> Check:
    """Return a check that accepts null and all values that ``check`` accepts."""
    return lambda value, place: None if value is None else check(value, place)


def each(check: Check, *, least: int = 0, length: int | None = None) -> Check:
    """Return a check for a list whose entries all pass ``check``."""

    def check_all(value: Any, place: str) -> None:
        if not isinstance(value, list):
            raise _mismatch(place, "a list", value)
        if len(value) < least or length not in (None, len(value)):
            wanted = f"{length} entries" if length is not None else f"at least {least}"
            raise Mismatch(f"{place}: expected {wanted}, got {len(value)}")
        for index, entry in enumerate(value):
            check(entry, f"{place}[{index}]")

    return check_all


def table(
    required: Mapping[str, Check] | None = None,
    optional: Mapping[str, Check] | None = None,
    others: Check = anything,
) -> Check:
    """Return a check for an object with ``required`` and ``optional`` keys; ``others`` checks all other values."""
    needed = dict(required or {})
    known = dict(optional or {}) | needed

    def check(value: Any, place: str) -> None:
        if not isinstance(value, dict):
            raise _mismatch(place, "a table of names and values", value)
        missing = [name for name in needed if name not in value]
        if missing:
            raise Mismatch(f"{place or 'it'} lacks {', '.join(missing)}")
        for name, entry in value.items():
            known.get(name, others)(entry, f"{place}.{name}" if place else short_repr(name).strip("'"))

    return check


def read_checked_json(path: Path, check: Check = anything) -> Any:
    """Return the content of a JSON file; raise OSError if it cannot be opened, `Mismatch` for any other fault."""
    if path.exists() and not path.is_file():
        raise Mismatch("it is not a regular file")
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > MAX_JSON_BYTES:
            raise Mismatch(f"it has {size:,} bytes, at most {MAX_JSON_BYTES:,} are read")
        return checked_json(file.read(), check)


def checked_json(content: bytes, check: Check = anything) -> Any:
    """Return the content of JSON bytes; raise `Mismatch` if they cannot be parsed or do not pass ``check``."""
    try:
        value = json.loads(content.decode("utf-8"), parse_constant=_no_constant)
        check_depth(value)
    except UnicodeDecodeError:
        raise Mismatch("it is not UTF-8 text") from None
    except RecursionError:
        raise Mismatch(f"it is nested deeper than {_MAX_DEPTH} levels") from None
    except Mismatch:
        raise
    except ValueError as error:
        raise Mismatch(f"it is not JSON ({' '.join(str(error).split())[:120]})") from None
    check(value, "")
    return value


def check_depth(value: Any) -> None:
    """Raise `Mismatch` if a value is nested so deeply that recursive functions would fail."""
    level = [value]
    for _ in range(_MAX_DEPTH):
        level = [
            entry
            for outer in level
            if isinstance(outer, dict | list)
            for entry in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if not level:
            return
    raise Mismatch(f"it is nested deeper than {_MAX_DEPTH} levels")


@dataclass(frozen=True)
class Array:
    """Describe one array of an npz file; a size given by name must be equal in all arrays of the file."""

    dtype: str  # kind and bytes of a number: f8, i8, u1, b1; the array must have exactly this type
    shape: tuple[int | str, ...]
    low: float = -MAX_NUMBER
    high: float = MAX_NUMBER
    least: int = 0  # minimum of every named size


def check_arrays(arrays: Mapping[str, np.ndarray], layout: Mapping[str, Array]) -> dict[str, int]:
    """Return the named sizes; raise `Mismatch` for a missing array, a wrong shape or type, or a value out of range."""
    missing = [name for name in layout if name not in arrays]
    if missing:
        raise Mismatch(f"it lacks the array {', '.join(missing)}")
    sizes: dict[str, int] = {}
    for name, wanted in layout.items():
        found = arrays[name]
        known = (sizes.get(size, size) if isinstance(size, str) else size for size in wanted.shape)
        expected = " x ".join(map(str, known)) or "a single number"
        dtype = np.dtype(wanted.dtype)
        if found.ndim != len(wanted.shape) or found.dtype != dtype:
            raise Mismatch(f"{name}: expected {dtype}, {expected}, got {found.dtype.str} of the shape {found.shape}")
        for size, have in zip(wanted.shape, found.shape):
            least = wanted.least if isinstance(size, str) else size
            if have < least or have != (sizes.setdefault(size, have) if isinstance(size, str) else size):
                raise Mismatch(f"{name}: expected {expected}, got the shape {found.shape}")
        if found.dtype.kind in "fiu" and found.size:
            least_value, most = float(found.min()), float(found.max())
            if not (math.isfinite(least_value) and math.isfinite(most)):
                raise Mismatch(f"{name} holds numbers that are not finite")
            if least_value < wanted.low or most > wanted.high:
                raise Mismatch(f"{name} holds numbers outside {wanted.low:g} .. {wanted.high:g}")
    return sizes


def _no_constant(name: str) -> Any:
    raise Mismatch(f"it holds {name}, which is not JSON")


def _mismatch(place: str, wanted: str, value: Any) -> Mismatch:
    return Mismatch(f"{place or 'it'}: expected {wanted}, got {short_repr(value)}")
