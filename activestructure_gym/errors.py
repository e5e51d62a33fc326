"""The one error a user is meant to read, and the helper that names the nearest valid choice."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Something the user gave cannot be used.

    The message is one clear sentence: what was expected, what came, what to do. The command line prints it
    without a traceback and exits with 2.
    """


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """The error for a mistyped name, e.g. ``unknown policy 'frontire'; did you mean 'frontier'? Known: ...``."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else "."
    return InputError(f"unknown {kind} '{name}'{hint} Known: {', '.join(names) or 'none'}")
