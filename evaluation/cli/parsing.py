"""From the words behind ``asg COMMAND`` to its options; what cannot be read is one sentence, and no box."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from typing import Any, TypeVar

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from activestructure_gym.errors import InputError, shown

T = TypeVar("T")
_SHELLS = ("bash", "zsh", "tcsh", "fish")
_HELP_COLUMNS = 110  # where no terminal says how wide it is
_ENDLESS = 1_000_000  # columns: nothing that tyro says is wrapped
_MOST = 2.0**63  # what a number of an option may be; each has limits of its own besides
_RULE = re.compile(r"[─-]+|╰─+╯")


def parse(kind: type[T], name: str, words: Sequence[str]) -> T:
    """The options of a command; raises `InputError`, and `SystemExit` after help."""
    for word in words:
        if "\0" in word or not _encodable(word):
            raise InputError(f"asg {name}: {shown(word)} holds bytes that are no text")
    if words and words[0].replace("_", "-") in ("--tyro-print-completion", "--tyro-write-completion"):
        raise InputError(f"asg {name} has no option {words[0]}; asg completion {'|'.join(_SHELLS[:2])} prints a script")
    said = io.StringIO()
    helped = any(word in ("-h", "--help") for word in words)
    try:
        with _columns(_columns_of_help() if helped else _ENDLESS), redirect_stderr(said):
            return tyro.cli(kind, prog=f"asg {name}", args=list(words), registry=_VALUES)
    except SystemExit as end:
        if end.code in (None, 0):
            raise
    raise InputError(f"{sentence(said.getvalue())}; asg {name} --help shows the options")


def sentence(box: str) -> str:
    """What tyro says in a box of many lines, in one."""
    lines = re.sub(r"\x1b\[[0-9;]*m", "", box).splitlines()[1:]  # without the colours and the title
    parts: list[list[str]] = [[]]
    for row in (line.strip("│ \t") for line in lines):
        if not _RULE.fullmatch(row):
            parts[-1] += [row] if row else []
        elif parts[-1]:
            parts.append([])
    said = " ".join(parts[0]).removeprefix("Error parsing ").rstrip(".")
    said = re.sub(r"\.? \(required\)$", "", said)
    meant = [part[1].split(",")[0].split()[0] for part in parts[1:] if len(part) > 1 and _SUGGESTS.match(part[0])]
    if len(said) > 300:
        said = f"{said[:260]}... ({len(said)} characters)"
    said = said[:1].lower() + said[1:]
    return said + (f"; did you mean {' and '.join(meant)}?" if meant else "")


_SUGGESTS = re.compile(r"Perhaps you meant|Arguments? similar to")


def _encodable(word: str) -> bool:
    try:
        word.encode()
    except UnicodeEncodeError:  # bytes that are no UTF-8 arrive as lone surrogates
        return False
    return True


@contextmanager
def _columns(number: int) -> Iterator[None]:
    """As wide as this is the terminal, as far as tyro can tell."""
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
    """How a value of one kind is read, and where an option may be left away, a value of this kind or None."""

    def read(texts: list[str]) -> Any:
        try:
            value = kind(texts[0])
        except ValueError:  # more digits than Python reads come here too
            value = None
        if value is None or not good(value):
            raise ValueError(f"expected {wanted}, got {shown(texts[0])}")
        return value

    def rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
        if info.type != kind | None and (info.type is not kind or kind is str):
            return None
        return PrimitiveConstructorSpec(1, metavar, read, lambda value: True, lambda value: [str(value)])

    return rule


_VALUES = ConstructorRegistry()
_VALUES.primitive_rule(_rule(int, "N", "a whole number", lambda value: abs(value) < _MOST))
_VALUES.primitive_rule(_rule(float, "X", "a number", lambda value: abs(value) < _MOST))
_VALUES.primitive_rule(_rule(str, "TEXT", "a text", bool))
