"""Parse the words behind ``asg COMMAND`` with tyro; its messages and its help fit the terminal and its encoding."""

from __future__ import annotations

import io
import os
import re
import sys
import textwrap
import typing
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.cli.commands import parts_of
from activestructure_gym.streams import Stream, flat, raw, write_line

T = TypeVar("T")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_HELP_COLUMNS = 110  # where no terminal says how wide it is
_MAX_NUMBER = 2.0**63  # what a number of an option may be; each has limits of its own besides
_MAX_CHARACTERS = 160  # characters of a word in a message


def parse(kind: type[T], name: str, words: Sequence[str]) -> T:
    """Return the options of a command.

    Raises `InputError` for bytes that are no text, and `SystemExit`: 0 after help, 2 after tyro's message about words
    that cannot be read.
    """
    for word in words:
        if "\0" in word or not _encodable(word):
            raise InputError(f"{name}: {short_repr(word)} holds bytes that are no text")
    if words and words[0].replace("_", "-").startswith("--tyro-"):
        raise InputError(f"{name} has no option {short_repr(words[0])}; `asg completion` prints a script for a shell")
    words = gathered(words, _lists(kind))
    helped = any(word in ("-h", "--help") for word in words)
    try:
        with redirect_stdout(_Folded(raw(sys.stdout)) if helped else _Uncoloured()), redirect_stderr(io.StringIO()):
            return _read(kind, f"asg {name}", words)
    except SystemExit as end:
        if not end.code:
            raise
    # A message repeats words: again, with words as they can be printed. Of its name tyro repeats what a space ends.
    message = io.StringIO()
    with suppress(SystemExit), redirect_stdout(_Uncoloured()), redirect_stderr(message):
        _read(kind, f"asg\xa0{name}", [_printable(word) for word in words])
    write_line(sys.stderr, message.getvalue().rstrip().replace("\xa0", " "))
    raise SystemExit(2)


class _Folded(Stream):
    """A standard output on which lines of help fit the terminal: tyro folds neither usage nor description."""

    def write(self, text: str) -> int:
        """Write the text with line breaks in lines that are too wide."""
        super().write("\n".join(line for whole in text.split("\n") for line in _folded(whole, _columns_of_help())))
        return len(text)


def _folded(line: str, width: int) -> list[str]:
    plain = _COLOUR.sub("", line)
    if len(plain) <= width:
        return [line]
    indent = "    " if plain.startswith("usage:") else ""
    return textwrap.wrap(plain, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class _Uncoloured(io.StringIO):
    """A standard output for which tyro draws frames, and no colours."""

    encoding = "utf-8"  # type: ignore[assignment]


def _read(kind: type[T], program: str, words: Sequence[str]) -> T:
    with _columns(_columns_of_help()):
        return tyro.cli(kind, prog=program, args=words, registry=VALUES)


def _printable(word: str) -> str:
    return flat(word) if len(word) <= _MAX_CHARACTERS else f"{flat(word[:_MAX_CHARACTERS])}..."


def gathered(words: Sequence[str], lists: Collection[str]) -> list[str]:
    """Return the words with all values of a list behind the first time its option is given.

    tyro keeps the last time alone; its `UseAppendAction` takes one value a time.
    """
    current: list[str] = []  # an option and its values
    groups: dict[str | int, list[str]] = {0: current}
    for number, word in enumerate(words, 1):
        option, equals, value = word.partition("=")
        option = option.replace("_", "-")
        if option in lists:
            current = groups.setdefault(option, [option])
            current += [value] if equals else []
        elif word.startswith("--") or (word[:1] == "-" and word[1:2].isalpha()):
            current = groups[number] = [word]
        else:
            current.append(word)
    return [word for group in groups.values() for word in group]


def _lists(kind: type) -> set[str]:
    """Return the options of a command, or of its parts, that take any number of values."""
    hints = [typing.get_type_hints(part) for part in (kind, *parts_of(kind).values())]
    return {f"--{name.replace('_', '-')}" for one in hints for name, hint in one.items() if "tuple[" in str(hint)}


def _encodable(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:  # bytes that are no UTF-8 arrive as lone surrogates
        return False
    return True


@contextmanager
def _columns(number: int) -> Iterator[None]:
    """While the block runs, let tyro format for a terminal of this many columns."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(number)
    try:
        yield
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before


def _columns_of_help() -> int:
    given = os.environ.get("COLUMNS", "")
    if given.isascii() and given.isdigit() and 20 <= int(given[:6]) <= 1000:
        return int(given)
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns or _HELP_COLUMNS
    except (OSError, ValueError):
        return _HELP_COLUMNS


def _rule(kind: type, metavar: str, wanted: str, good: Callable[[Any], bool]) -> Callable[[PrimitiveTypeInfo], Any]:
    """tyro's rule to parse one type: values of ``kind`` that are ``good``, or None where the option is optional."""

    def read(texts: list[str]) -> Any:
        try:
            value = kind(texts[0])
        except ValueError:  # more digits than Python reads come here too
            value = None
        if value is None or not good(value):
            raise ValueError(f"expected {wanted}, got {short_repr(texts[0])}")
        return value

    def rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        if info.type != kind | None and (info.type is not kind or kind is str):
            return None
        return PrimitiveConstructorSpec(1, metavar, read, lambda value: True, lambda value: [str(value)])

    return rule


def _choice(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """tyro's rule for one of some names, or None where the option is not typed; tyro's own takes the word None, too."""
    names, *others = get_args(info.type) or (None,)
    if others != [NoneType] or get_origin(names) is not Literal:
        return None
    choices = get_args(names)
    return PrimitiveConstructorSpec(
        1,
        "{" + ",".join(choices) + "}",
        lambda texts: texts[0],
        lambda value: True,
        lambda value: [str(value)],
        choices,
    )


def _words(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """tyro's rule for any number of texts, or None where the option is not typed."""
    if info.type != tuple[str, ...] | None:
        return None
    return PrimitiveConstructorSpec("*", "[TEXT ...]", tuple, lambda value: True, lambda value: list(value or ()))


VALUES = ConstructorRegistry()
VALUES.primitive_rule(_rule(int, "N", "a whole number", lambda value: abs(value) < _MAX_NUMBER))
VALUES.primitive_rule(_rule(float, "X", "a number", lambda value: abs(value) < _MAX_NUMBER))
VALUES.primitive_rule(_rule(str, "TEXT", "a text", bool))
VALUES.primitive_rule(_choice)
VALUES.primitive_rule(_words)
