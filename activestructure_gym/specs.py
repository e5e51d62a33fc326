"""Parse names with options, such as ``apartment?seed=3&rooms=4`` or ``naruto?travel=shared``.

The name refers to a function or class. Its parameters are the options, and their annotations are the types.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Collection, Mapping
from types import UnionType
from typing import Any, Literal
from urllib.parse import parse_qsl

from activestructure_gym.errors import InputError, short_repr, unknown_name

Kind = Literal["registered", "plug-in", "checkpoint", "trajectory", "reference"]
_PREFIXES: dict[str, Kind] = {"learned": "checkpoint", "trajectory": "trajectory", "reference": "reference"}


class Spec(str):
    """Hold a name and its options as one text, such as ``naruto?travel=shared`` or ``trajectory:FILE?axes=opengl``."""

    name: str  # the part before the question mark
    query: str  # the part after the question mark, not parsed

    def __new__(cls, text: str) -> Spec:
        """Split a text at its first question mark; raise `InputError` if it is not a str."""
        if not isinstance(text, str):
            raise InputError(f"a name is given as a text, got {short_repr(text)}")
        spec = super().__new__(cls, text)
        spec.name, _, spec.query = text.partition("?")
        return spec

    @classmethod
    def joined(cls, name: str, query: str) -> Spec:
        """Return the text that consists of a name and its options, ``name?query``; without options only the name."""
        return cls(f"{name}?{query}" if query else name)

    @property
    def kind(self) -> Kind:
        """Return the kind of policy that the name refers to, from the prefix before its colon.

        Names without a colon are registered; an unknown prefix is a module to import (a plug-in).
        """
        prefix, colon, _ = self.name.partition(":")
        return _PREFIXES.get(prefix, "plug-in") if colon else "registered"

    @property
    def place(self) -> str:
        """Return the part of the name after the colon: a file, a class of a module, or the name of a reference."""
        return self.name.partition(":")[2]

    def options(self, label: str) -> dict[str, str]:
        """Return the options as a dict of texts; ``label`` is described at `parse_options`."""
        return parse_options(self.query, label)


def parse_options(query: str, label: str) -> dict[str, str]:
    """Parse ``key=value&key=value`` into a dict.

    Percent escapes such as ``%26`` are decoded, but a plus sign is not read as a space. Raises `InputError` for another
    form and for a key with two different values; ``label`` names the owner of the options in the message.
    """
    try:
        pairs = parse_qsl(query.replace("+", "%2B"), keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise InputError(f"'{query}' in {label} is not of the form key=value&key=value") from error
    options = dict(pairs)
    for key, value in pairs:
        if options[key] != value:
            raise InputError(f"'{query}' in {label} says {key} twice: {value} and {options[key]}")
    return options


def escaped_option(value: str) -> str:
    """Return the value of an option as it is written in a name, so that `parse_options` returns it again."""
    return value.replace("%", "%25").replace("&", "%26")


def number_text(value: float) -> str:
    """Return the shortest text that parses to the same number, such as ``2``, ``0.3`` or ``17.188733853924695``."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def typed_options(
    label: str,  # owner of the options for messages, as in "scene 'box'"
    factory: Callable[..., Any],
    options: Mapping[str, Any],
    *,
    apart: Collection[str] = (),  # parameters of the factory that are not options
    more: Collection[str] = (),  # options that the caller reads itself, to name them in messages
) -> dict[str, Any]:
    """Return the options as keyword arguments for ``factory``, with texts converted to the annotated types.

    Values that are not texts are unchanged. Raises `InputError` for an unknown option, for a text that cannot be
    converted, and for a missing option without default.
    """
    parameters = {key: p for key, p in inspect.signature(factory).parameters.items() if key not in apart}
    takes_any = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    known = [key for key, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    if options and not known and not more and not takes_any:
        given = "&".join(f"{key}={value}" for key, value in options.items())
        raise InputError(f"{label} takes no options, got '{given}'; remove them")
    hints = _hints(factory)
    arguments = {}
    for key, value in options.items():
        if key not in known and not takes_any:
            raise unknown_name(f"option of {label}", key, [*known, *more])
        arguments[key] = _typed(f"option {key} of {label}", value, hints.get(key, Any))
    missing = [k for k in known if parameters[k].default is inspect.Parameter.empty and k not in arguments]
    if missing:
        raise InputError(f"{label} needs the option {missing[0]} (as in 'NAME?{missing[0]}=...')")
    return arguments


def _hints(factory: Any) -> dict[str, Any]:
    """Return the type of each parameter of a function or class: its annotation, or else the type of its default."""
    defaults = {
        key: type(p.default)
        for key, p in inspect.signature(factory).parameters.items()
        if isinstance(p.default, bool | int | float)
    }
    takes = factory.__init__ if isinstance(factory, type) else factory  # type: ignore[misc]
    try:
        return {**defaults, **typing.get_type_hints(takes)}
    except (NameError, TypeError):  # an annotation that is imported for type checkers only, or a callable object
        return defaults


def _typed(what: str, value: Any, hint: Any) -> Any:
    """Convert a text to the type ``hint``; return other values unchanged. ``what`` names the option in messages."""
    if not isinstance(value, str):
        return value
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        # Numbers are tried first, because every text is valid as a text.
        order = sorted(inner, key=lambda t: {bool: 0, int: 1, float: 2}.get(t, 3))
        for candidate in (t for t in order if t is not type(None)):
            try:
                return _typed(what, value, candidate)
            except InputError:
                continue
        raise InputError(f"{what} cannot be '{value}'")
    try:
        if hint is bool:
            return {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}[value.lower()]
        if hint in (int, float):
            return hint(value)
        if origin is tuple:
            items = value.split(",")
            kinds = [inner[0]] * len(items) if inner[-1] is Ellipsis else list(inner)
            if len(items) != len(kinds):
                raise ValueError
            return tuple(_typed(what, item, kind) for item, kind in zip(items, kinds))
    except (ValueError, KeyError):
        words = {bool: "true or false", int: "a whole number", float: "a number"}
        expected = f"{len(inner)} values with commas" if origin is tuple else words.get(hint, str(hint))
        raise InputError(f"{what} must be {expected}, got '{value}'") from None
    return value
