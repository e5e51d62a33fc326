"""Parse the arguments of ``asg COMMAND`` with tyro; help and errors fit the terminal and its encoding."""

from __future__ import annotations

import io
import os
import re
import sys
import textwrap
import typing
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from itertools import pairwise
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.evaluation.cli.commands import parts_of
from activestructure_gym.streams import Stream, flat, raw, write_line

T = TypeVar("T")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # ANSI escape sequence of a colour
_HELP_COLUMNS = 110  # width of help in characters if the output is not a terminal
_MAX_NUMBER = 2.0**63  # limit of the absolute value of every number; most options have narrower limits
_MAX_CHARACTERS = 160  # longest argument that an error message repeats in full


def parse(kind: type[T], name: str, words: Sequence[str]) -> T:
    """Parse the arguments ``words`` of the command ``name``, and return an object of its class ``kind``.

    Raise `InputError` for bytes that are not text, and for an option of several values without any. Raise `SystemExit`
    after help is printed, with code 0, and after an error message of tyro is printed, with code 2.
    """
    for word in words:
        if "\0" in word or not _encodable(word):
            raise InputError(f"{name}: {short_repr(word)} holds bytes that are not text")
    if words and words[0].replace("_", "-").startswith("--tyro-"):
        raise InputError(f"{name} has no option {short_repr(words[0])}; `asg completion` prints a script for a shell")
    lists = _lists(kind)
    words = gathered(words, lists)
    helped = any(word in ("-h", "--help") for word in words)
    for option, value in pairwise([*words, "--"]):
        if option in lists and (not value.strip(" ,") or _names_option(value)) and not helped:
            raise InputError(f"{name}: {option} lacks a value; `asg {name} --help` names its values")
    try:
        with redirect_stdout(_Folded(raw(sys.stdout)) if helped else _Uncoloured()), redirect_stderr(io.StringIO()):
            return _read(kind, f"asg {name}", words)
    except SystemExit as end:
        if not end.code:
            raise
    # Tyro's error message repeats arguments, so they are parsed again in a printable form. In this message, tyro cuts
    # the program's name at a space, so "asg" and the command are joined by a no-break space.
    message = io.StringIO()
    with suppress(SystemExit), redirect_stdout(_Uncoloured()), redirect_stderr(message):
        _read(kind, f"asg\xa0{name}", [_printable(word) for word in words])
    write_line(sys.stderr, message.getvalue().rstrip().replace("\xa0", " "))
    raise SystemExit(2)


class _Folded(Stream):
    """Write help with lines folded to the width of the terminal, since tyro does not fold the usage and description."""

    def write(self, text: str) -> int:
        """Write ``text`` with its lines folded to the width of help; return its number of characters."""
        super().write("\n".join(line for whole in text.split("\n") for line in _folded(whole, _columns_of_help())))
        return len(text)


def _folded(line: str, width: int) -> list[str]:
    plain = _COLOUR.sub("", line)
    if len(plain) <= width:
        return [line]
    indent = "    " if plain.startswith("usage:") else ""
    return textwrap.wrap(plain, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class _Uncoloured(io.StringIO):
    """Collect output in memory; with the encoding UTF-8, tyro draws frames around messages, without colours."""

    encoding = "utf-8"  # type: ignore[assignment]


def _read(kind: type[T], program: str, words: Sequence[str]) -> T:
    with _columns(_columns_of_help()):
        return tyro.cli(kind, prog=program, args=words, registry=VALUES)


def _printable(word: str) -> str:
    return flat(word) if len(word) <= _MAX_CHARACTERS else f"{flat(word[:_MAX_CHARACTERS])}..."


def gathered(words: Sequence[str], lists: Collection[str]) -> list[str]:
    """Join repeated list options: move the values of every further occurrence to the first one.

    ``words`` are arguments, and ``lists`` the options that take several values. Tyro alone would use only the last
    occurrence, and its `UseAppendAction` takes one value per occurrence.
    """
    current: list[str] = []  # an option, followed by its values
    groups: dict[str | int, list[str]] = {0: current}
    for number, word in enumerate(words, 1):
        option, equals, value = word.partition("=")
        option = option.replace("_", "-")
        if option in lists:
            current = groups.setdefault(option, [option])
            current += [value] if equals else []
        elif _names_option(word):
            current = groups[number] = [word]
        else:
            current.append(word)
    return [word for group in groups.values() for word in group]


def _names_option(word: str) -> bool:
    return word.startswith("--") or (word[:1] == "-" and word[1:2].isalpha())


def _lists(kind: type) -> set[str]:
    """Return the options, such as "--scenes", of a command and its subcommands that take any number of values."""
    hints = [typing.get_type_hints(part) for part in (kind, *parts_of(kind).values())]
    return {f"--{name.replace('_', '-')}" for one in hints for name, hint in one.items() if "tuple[" in str(hint)}


def _encodable(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:  # Python decodes argument bytes that are not UTF-8 as lone surrogates
        return False
    return True


@contextmanager
def _columns(number: int) -> Iterator[None]:
    """Make tyro format its output for a width of ``number`` characters during the ``with`` block."""
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
    """Return a tyro rule for options of the type ``kind``, or optionally None, that checks values by ``good``.

    ``metavar`` is the placeholder of a value in help, and ``wanted`` describes correct values in the error message.
    """

    def read(texts: list[str]) -> Any:
        try:
            value = kind(texts[0])
        except ValueError:  # also raised for a number with thousands of digits
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
    """Return the rule for options of a type ``Literal[...] | None``; tyro's own rule would accept the text None."""
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
    """Return the rule for options of the type ``tuple[str, ...] | None``, which are None if not given."""
    if info.type != tuple[str, ...] | None:
        return None
    return PrimitiveConstructorSpec("*", "[TEXT ...]", tuple, lambda value: True, lambda value: list(value or ()))


VALUES = ConstructorRegistry()
VALUES.primitive_rule(_rule(int, "N", "a whole number", lambda value: abs(value) < _MAX_NUMBER))
VALUES.primitive_rule(_rule(float, "X", "a number", lambda value: abs(value) < _MAX_NUMBER))
VALUES.primitive_rule(_rule(str, "TEXT", "a text", bool))
VALUES.primitive_rule(_choice)
VALUES.primitive_rule(_words)
