"""The one error a user is meant to read, and the words for names, values and counts that messages share."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """User input cannot be used: an option, a file, a name, a keyword.

    The message is one clear sentence: what was expected, what came, what to do. The command line prints it
    without a traceback and exits with 2.
    """


class InputWarning(UserWarning):
    """User input is used although something about it is doubtful, or after a choice was made for it.

    Given through `warnings`, so that it is read wherever the input is used; the command line prints it as one line.
    """


def unknown_name(kind: str, name: object, known: Iterable[str]) -> InputError:
    """The error for a mistyped name, e.g. ``unknown policy 'frontire'; did you mean 'frontier'? Known: ...``."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1) if isinstance(name, str) else []
    hint = f"; did you mean '{close[0]}'?" if close else "."
    return InputError(f"unknown {kind} {shown(name)}{hint} Known: {', '.join(names) or 'none'}")


def shown(value: object) -> str:
    """A value as text for an error message: one line, shortened where it is long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # whole numbers of thousands of digits, and whatever the objects of others raise
        return f"something of the kind {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:160]}... ({len(text)} characters)"


def counted(number: int, one: str, many: str | None = None) -> str:
    """A number with what it counts: ``1 run``, ``2 runs``."""
    return f"{number} {one if number == 1 else many or one + 's'}"
