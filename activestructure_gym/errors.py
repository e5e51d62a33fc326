"""Define the error and the warning for user input, and helpers that format names, values and counts for messages."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

MAX_NAMES = 5  # maximum number of names in a message
# Commands that list the known names of each kind.
_LISTS = {
    "policy": "asg list policies",
    "feature": "asg list features",
    "scene": "asg list scenes",
    "world": "asg list worlds",
    "command": "asg --help",
    "field of RewardConfig": "",
}
MAX_CHARACTERS = 1500  # maximum length of a message, characters


def printable(text: str) -> str:
    r"""Return the text with control characters escaped (``\x1b``); line ends remain, and a tab becomes a space.

    Bidirectional control characters and lone surrogates are escaped as well.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" else _written(c) for c in text)


def one_line(text: str) -> str:
    """Return a text from outside this program as one printable line of at most `MAX_CHARACTERS` characters.

    The middle of a longer text is left out.
    """
    if len(text) > 20 * MAX_CHARACTERS:  # the middle is left out anyway
        text = f"{text[: 10 * MAX_CHARACTERS]} {text[-10 * MAX_CHARACTERS :]}"
    text = printable(" ".join(text.split()))
    return text if len(text) <= MAX_CHARACTERS else f"{text[: MAX_CHARACTERS - 200]} ... {text[-150:]}"


def _written(character: str) -> str:
    return " " if character == "\t" else character.encode("unicode_escape").decode()


class InputError(ValueError):
    """Report user input that cannot be used: an option, a file, a name or a keyword.

    The message is one sentence: what is wrong, what was expected, what to do. The command line prints it without a
    traceback and exits with code 2. The message is always one printable line of at most `MAX_CHARACTERS` characters,
    even if it contains text from a file or a name.
    """

    def __init__(self, *said: object) -> None:
        super().__init__(*(one_line(part) if isinstance(part, str) else part for part in said))


class FullDisk(InputError):
    """Report that a file cannot grow, because of a full disk, a quota or a file size limit.

    The user's input is valid in this case, so the command line exits with code 1 and not 2.
    """


class UnknownKeyword(InputError, TypeError):
    """Report a keyword argument that a function does not have.

    The class is also a `TypeError`, and its message begins like Python's own. TorchRL and Gymnasium pass keywords to
    every environment and drop a keyword if they get this error.
    """


class InputWarning(UserWarning):
    """Warn that user input is doubtful or ambiguous, although it is used.

    The warning is issued through `warnings`; the command line prints it as one line. The message is one printable line.
    """

    def __init__(self, *said: object) -> None:
        super().__init__(*(one_line(part) if isinstance(part, str) else part for part in said))


def unknown_name(kind: str, name: object, known: Iterable[str]) -> InputError:
    """Return the error for an unknown ``name``, with the nearest known name and the command that lists all names.

    ``kind`` is the kind of name, such as "policy" or "option of scene 'room'". For example: ``unknown policy
    'frontire'; did you mean 'frontier'? `asg list policies` lists the names``, and ``unknown option 'sed' of scene
    'room'``. If there is no command, at most `MAX_NAMES` names are listed.
    """
    command = _LISTS.get(kind, "asg list config" if kind.startswith("field") else "")
    noun, of, owner = kind.partition(" of ")
    if " " in noun:
        noun, of, owner = kind, "", ""
    return InputError(f"unknown {noun} {short_repr(name)}{of}{owner}{_nearest(name, known, command)}")


def unknown_keyword(function: str, name: str, known: Iterable[str]) -> UnknownKeyword:
    """Return the error for a keyword ``name`` that ``function`` does not have, with the nearest ``known`` keyword."""
    return UnknownKeyword(f"{function}() got an unexpected keyword argument '{name}'{_nearest(name, known)}")


def _nearest(name: object, known: Iterable[str], command: str = "") -> str:
    """Return the end of a message about an unknown name: the nearest known name, and where all names are listed."""
    names = sorted(known)
    word = name if isinstance(name, str) else ""
    close = difflib.get_close_matches(word, names, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else "."
    if len(names) <= MAX_NAMES:
        where = f"Known: {', '.join(names) or 'none'}"
    elif command:
        where = f"`{command}` lists the names"
    else:
        nearest = difflib.get_close_matches(word, names, n=MAX_NAMES, cutoff=0.0)
        where = f"Nearest of {len(names)}: {', '.join(nearest)}"
    return f"{hint} {where}"


def listed(names: Iterable[object], most: int = MAX_NAMES) -> str:
    """Return names separated by commas.

    Of a long list, return the first ``most`` names and the number of the others.
    """
    words = [str(name) for name in names]
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more


def short_repr(value: object) -> str:
    """Return the ``repr`` of a value for an error message, as one line of about 200 characters at most."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an integer of thousands of digits, or a faulty __repr__ method
        return f"something of the kind {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:160]}... ({len(text)} characters)"


def pluralised(number: int, one: str, many: str | None = None) -> str:
    """Return a count with its noun in the right number, such as ``1 run`` or ``2 runs``.

    ``many`` is an irregular plural.
    """
    return f"{number} {one if number == 1 else many or one + 's'}"
