"""The one error a user is meant to read, and the words for names, values and counts that messages share."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

MOST_NAMES = 5  # that a message lists
# The commands that list the names of a kind.
_LISTS = {
    "policy": "asg policies",
    "feature": "asg features",
    "scene": "asg scenes",
    "command": "asg --help",
}
LONGEST = 1500  # characters of a message


def printable(text: str) -> str:
    """Return the text with its control characters written out (``\\x1b``); line ends stay, a tab becomes a space.

    Among them are the characters that change the direction of writing, and halves of surrogate pairs.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" else _written(c) for c in text)


def one_line(text: str, longest: int = LONGEST) -> str:
    """Return foreign text as one printable line, shortened in the middle."""
    if len(text) > 20 * longest:  # nothing of the rest is shown
        text = f"{text[: 10 * longest]} {text[-10 * longest :]}"
    text = printable(" ".join(text.split()))
    return text if len(text) <= longest else f"{text[: longest - 200]} ... {text[-150:]}"


def _written(character: str) -> str:
    return " " if character == "\t" else character.encode("unicode_escape").decode()


class InputError(ValueError):
    """User input cannot be used: an option, a file, a name, a keyword.

    The message is one clear sentence: what was expected, what came, what to do. The command line prints it
    without a traceback and exits with 2. Whatever a file or a name puts into it, it is one printable line of at most
    `LONGEST` characters.
    """

    def __init__(self, *said: object) -> None:
        super().__init__(*(one_line(part) if isinstance(part, str) else part for part in said))


class FullDisk(InputError):
    """A file has no room: a full disk, a quota, a limit on sizes. Nothing of the input is wrong; exit code 1, not 2."""


class UnknownKeyword(InputError, TypeError):
    """A keyword that a function does not have: a `TypeError` as well, as Python's own, whose words it begins with.

    TorchRL and Gymnasium try keywords on every environment, and take back those that are refused in this way.
    """


class InputWarning(UserWarning):
    """User input is used although something about it is doubtful, or after a choice was made for it.

    Given through `warnings`, so that it is read wherever the input is used; the command line prints it as one line. Its
    message is held to the same form as that of an `InputError`.
    """

    def __init__(self, *said: object) -> None:
        super().__init__(*(one_line(part) if isinstance(part, str) else part for part in said))


def unknown_name(kind: str, name: object, known: Iterable[str]) -> InputError:
    """Return the error for a mistyped name, with the nearest name and the command that lists all of them.

    For example ``unknown policy 'frontire'; did you mean 'frontier'? `asg policies` lists the names``. A message holds
    all names where they are few, and at most `MOST_NAMES` of many.
    """
    command = "asg config" if kind.startswith("field") else _LISTS.get(kind, "")
    return InputError(f"unknown {kind} {shown(name)}{_nearest(name, known, command)}")


def unknown_keyword(function: str, name: str, known: Iterable[str]) -> UnknownKeyword:
    """Return the error for a keyword that ``function`` does not have, with the nearest one."""
    return UnknownKeyword(f"{function}() got an unexpected keyword argument '{name}'{_nearest(name, known)}")


def _nearest(name: object, known: Iterable[str], command: str = "") -> str:
    """The end of a message about an unknown name."""
    names = sorted(known)
    word = name if isinstance(name, str) else ""
    close = difflib.get_close_matches(word, names, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else "."
    if len(names) <= MOST_NAMES:
        where = f"Known: {', '.join(names) or 'none'}"
    elif command:
        where = f"`{command}` lists the names"
    else:
        nearest = difflib.get_close_matches(word, names, n=MOST_NAMES, cutoff=0.0)
        where = f"Nearest of {len(names)}: {', '.join(nearest)}"
    return f"{hint} {where}"


def listed(names: Iterable[object], most: int = MOST_NAMES) -> str:
    """Return the names in one line: ``a, b``, or of many the first ``most`` and how many more there are."""
    words = [str(name) for name in names]
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


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
