"""Parse the words behind ``asg COMMAND`` with tyro; what cannot be parsed is an `InputError` of one sentence."""

from __future__ import annotations

import io
import os
import re
import sys
import typing
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from itertools import takewhile
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from activestructure_gym.errors import InputError, shown, unknown_name
from activestructure_gym.evaluation.cli.commands import parts_of
from activestructure_gym.streams import raw

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
            raise InputError(f"{name}: {shown(word)} holds bytes that are no text")
    if words and words[0].replace("_", "-") in ("--tyro-print-completion", "--tyro-write-completion"):
        raise InputError(f"{name} has no option {words[0]}; asg completion {'|'.join(_SHELLS[:2])} prints a script")
    part = words[0] if words and words[0] in parts_of(kind) else ""
    said = io.StringIO()
    helped = any(word in ("-h", "--help") for word in words)
    try:
        columns = _columns_of_help() if helped else _ENDLESS
        with _columns(columns), redirect_stderr(said), redirect_stdout(raw(sys.stdout)):
            words = gathered(words, _lists(parts_of(kind).get(part, kind)))
            return tyro.cli(kind, prog=f"asg {name}", args=words, registry=_VALUES)
    except SystemExit as end:
        if end.code in (None, 0):
            raise
    command, told = f"asg {name} {part}".rstrip(), sentence(said.getvalue(), part)
    belongs = [option for word in _stray(told) if (option := _option_of(kind, word))]
    raise InputError(f"{_with_options(told, belongs)}; {command} --help shows the options".replace("?; ", "? "))


def gathered(words: Sequence[str], lists: Collection[str]) -> list[str]:
    """The words with all values of a list behind the first time its option stands there.

    tyro keeps the last time alone: of ``--set a=1 --set b=2`` nobody would miss the first until the numbers are out.
    """
    current: list[str] = []  # an option and its values
    groups, firsts = [current], dict[str, list[str]]()
    for word in words:
        option, equals, value = word.partition("=")
        option = option.replace("_", "-")
        if option in lists and option in firsts:
            current = firsts[option]
            current += [value] if equals else []
        elif option in lists or word.startswith("--"):
            current = [option, value] if option in lists and equals else [word]
            firsts[option] = current
            groups.append(current)
        else:
            current.append(word)
    return [word for group in groups for word in group]


def _lists(kind: type) -> set[str]:
    """The options of a command that take any number of values."""
    hints = typing.get_type_hints(kind)
    return {f"--{name.replace('_', '-')}" for name, hint in hints.items() if "tuple[" in str(hint)}


def _stray(told: str) -> list[str]:
    """Words that stand behind no option, of tyro's message in one sentence."""
    return told.partition("unrecognized options: ")[2].partition(";")[0].split(", ")


def _option_of(kind: Any, word: str) -> str:
    """The option that a word without one is the value of, and that word, if it names a policy or a scene; else ''."""
    from activestructure_gym.policies import POLICIES
    from activestructure_gym.scenes.library import is_scene_name

    if not word or word.startswith("-"):
        return ""
    fields = getattr(kind, "__dataclass_fields__", {})
    bare = word.partition("?")[0]
    for options, known in (
        (("policies", "policy"), bare in POLICIES or word in ("all", "ladder")),
        (("scenes", "scene"), is_scene_name(word) or os.path.exists(os.path.expanduser(bare))),
    ):
        taken = [option for option in options if option in fields]
        if known and taken:
            return f"--{taken[0]} {word}"
    return ""


def _with_options(told: str, belongs: Sequence[str]) -> str:
    """Return the message with options and their values among the options that could have been meant, each once."""
    if not belongs:
        return told
    told, _, meant = told.partition("; did you mean ")
    options = [option for option in meant.removesuffix("?").split(" and ") if option]
    options = [option for option in options if not any(more.startswith(f"{option} ") for more in belongs)]
    return f"{told}; did you mean {' and '.join([*options, *belongs])}?"


def sentence(box: str, part: str = "") -> str:
    """tyro's boxed error message as one sentence; ``part`` is the subcommand of a command that has some."""
    lines = re.sub(r"\x1b\[[0-9;]*m", "", box).splitlines()[1:]  # without the colours and the title
    blocks: list[list[str]] = [[]]
    for row in (line.strip("│ \t") for line in lines):
        if not _RULE.fullmatch(row):
            blocks[-1] += [row] if row else []
        elif blocks[-1]:
            blocks.append([])
    said = " ".join(blocks[0]).removeprefix("Error parsing ").rstrip(".")
    said = re.sub(r"\.? \(required\)$", "", said)
    said = _APPLIED.sub(",", said).partition(", Arguments are applied to")[0].replace(" or misplaced", "", 1)
    given = said.partition(": ")[2].split(", ")
    parts = next((found[1].split(", ") for block in blocks[1:] if (found := _PARTS.fullmatch(" ".join(block)))), None)
    if parts:
        return str(unknown_name("part", given[0], parts))
    if len(said) > 300:
        said = f"{said[:260]}... ({len(said)} characters)"
    return "; ".join([said[:1].lower() + said[1:], *_hints(blocks[1:], given, part)])


_APPLIED = re.compile(r" \(applied to asg [a-z -]+\)")
_PARTS = re.compile(r"Available subcommands: (.+)")
_SUGGESTS = re.compile(r"Perhaps you meant|Arguments? similar to")
_ELSEWHERE = re.compile(r"in asg ([a-z-]+) --help")


def _hints(blocks: Sequence[Sequence[str]], given: Sequence[str], part: str) -> Iterator[str]:
    """Sentences on options that could have been meant, and on given ones that belong to another subcommand."""
    meant = []
    for rows in blocks:
        if len(rows) > 1 and _SUGGESTS.match(rows[0]):
            option = rows[1].split(",")[0].split()[0]
            places = _places(rows[1:], option)
            of = f" of {', '.join(places)}" if places and part not in places else ""
            if of and option in given:
                yield f"{option} is an option{of}" + ("" if part else " and stands behind that name")
            else:
                meant.append(option + of)
    if meant:
        yield f"did you mean {' and '.join(meant)}?"


def _places(rows: Sequence[str], option: str) -> list[str]:
    """Names of the subcommands that have ``option``, from the rows of tyro's message that are about it."""
    about = takewhile(lambda row: not row.startswith("--") or row.split()[0].rstrip(",") == option, rows)
    return [found[1] for row in about if (found := _ELSEWHERE.fullmatch(row))]


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
            raise ValueError(f"expected {wanted}, got {shown(texts[0])}")
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


_VALUES = ConstructorRegistry()
_VALUES.primitive_rule(_rule(int, "N", "a whole number", lambda value: abs(value) < _MOST))
_VALUES.primitive_rule(_rule(float, "X", "a number", lambda value: abs(value) < _MOST))
_VALUES.primitive_rule(_rule(str, "TEXT", "a text", bool))
_VALUES.primitive_rule(_choice)
_VALUES.primitive_rule(_words)
