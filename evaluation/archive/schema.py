"""Checks of files when they are read: kinds, ranges and lengths that agree.

A check is a function of a value and of its place in the file (``metrics.views[3].psnr``); it returns nothing or raises
`Mismatch`. Behind a check nobody needs to ask again whether a key is there or a number is finite. Keys that a check
does not know are left alone, so that a later version may write more.
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

MAX_NUMBER = 1e15  # of any number; above, whole numbers are no longer told apart
MAX_JSON_BYTES = 64 << 20  # bytes of a JSON file
_MAX_DEPTH = 32  # levels of nesting
_MAX_TEXT_CHARACTERS = 100_000  # characters


class Mismatch(ValueError):
    """A file does not hold what it should; the message says where, what was expected, and what came."""


def number(low: float = -MAX_NUMBER, high: float = MAX_NUMBER, *, whole: bool = False) -> Check:
    """A check for a finite number in ``low`` .. ``high``."""
    kind = "a whole number" if whole else "a number"

    def check(value: Any, place: str) -> None:
        good = isinstance(value, int) if whole else isinstance(value, int | float)
        if not good or isinstance(value, bool) or not low <= value <= high:
            limits = kind if (low, high) == (-MAX_NUMBER, MAX_NUMBER) else f"{kind} from {low:g} to {high:g}"
            raise _mismatch(place, limits, value)

    return check


def text(value: Any, place: str) -> None:
    """Any text, of tolerable length."""
    if not isinstance(value, str) or len(value) > _MAX_TEXT_CHARACTERS:
        raise _mismatch(place, "a text", value)


def scalar(value: Any, place: str) -> None:
    """A text, a number, true, false or null."""
    if isinstance(value, str):
        text(value, place)
    elif value is not None and not isinstance(value, bool):
        number()(value, place)


def anything(value: Any, place: str) -> None:
    """Whatever JSON can say."""


def flag(value: Any, place: str) -> None:
    """True or false."""
    if not isinstance(value, bool):
        raise _mismatch(place, "true or false", value)


def maybe(check: Check) -> Check:
    """A check that passes null, and what ``check`` passes."""
    return lambda value, place: None if value is None else check(value, place)


def each(check: Check, *, least: int = 0, length: int | None = None) -> Check:
    """A check for a list whose entries all pass ``check``."""

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
    """A check for a table of names: ``required`` must be there, ``optional`` may, others pass ``others``."""
    needed = dict(required or {})
    known = needed | dict(optional or {})

    def check(value: Any, place: str) -> None:
        if not isinstance(value, dict):
            raise _mismatch(place, "a table of names and values", value)
        missing = [name for name in needed if name not in value]
        if missing:
            raise Mismatch(f"{place or 'it'} lacks {', '.join(missing)}")
        for name, entry in value.items():
            known.get(name, others)(entry, f"{place}.{name}" if place else short_repr(name).strip("'"))

    return check


def read_checked_json(path: Path, check: Check = anything, *, most: int = MAX_JSON_BYTES) -> Any:
    """The content of a JSON file; OSError where it cannot be opened, `Mismatch` for everything else."""
    if path.exists() and not path.is_file():
        raise Mismatch("it is no regular file")
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise Mismatch(f"it has {size:,} bytes, at most {most:,} are read")
        return checked_json(file.read(), check)


def checked_json(content: bytes, check: Check = anything) -> Any:
    """The content of JSON given as bytes; `Mismatch` where it cannot be read or does not pass ``check``."""
    try:
        value = json.loads(content.decode("utf-8"), parse_constant=_no_constant)
        check_depth(value)
    except UnicodeDecodeError:
        raise Mismatch("it is no text in UTF-8") from None
    except RecursionError:
        raise Mismatch(f"it is nested deeper than {_MAX_DEPTH} levels") from None
    except Mismatch:
        raise
    except ValueError as error:
        raise Mismatch(f"it is no JSON ({' '.join(str(error).split())[:120]})") from None
    check(value, "")
    return value


def check_depth(value: Any) -> None:
    """Raise `Mismatch` for what is nested so deep that no function of ours could walk it."""
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
    """One array of an npz file. A name among the sizes is the same number in all arrays of the file."""

    dtype: str  # kind and bytes of a number: f8, i8, u1, b1; others are refused, wider ones too
    shape: tuple[int | str, ...]
    low: float = -MAX_NUMBER
    high: float = MAX_NUMBER
    least: int = 0  # of every named size


def check_arrays(arrays: Mapping[str, np.ndarray], layout: Mapping[str, Array]) -> dict[str, int]:
    """Raise `Mismatch` where arrays are missing, of another shape or kind, not finite or out of range.

    Returns the named sizes.
    """
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
    raise Mismatch(f"it holds {name}, which is no JSON")


def _mismatch(place: str, wanted: str, value: Any) -> Mismatch:
    return Mismatch(f"{place or 'it'}: expected {wanted}, got {short_repr(value)}")
