"""Parse names with options: ``apartment?seed=3&rooms=4``, ``naruto?travel=shared``.

Options and their types are the parameters and annotations of the function or class that takes them.
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
    """A text of a name and its options: ``naruto?travel=shared``, ``trajectory:FILE?axes=opengl``, ``module:Mine``."""

    name: str
    query: str  # options as given

    def __new__(cls, text: str) -> Spec:
        """Split a text at its first question mark; raise `InputError` for a value of another type."""
        if not isinstance(text, str):
            raise InputError(f"a name is given as a text, got {short_repr(text)}")
        spec = super().__new__(cls, text)
        spec.name, _, spec.query = text.partition("?")
        return spec

    @classmethod
    def joined(cls, name: str, query: str) -> Spec:
        """Return the text of a name and its options."""
        return cls(f"{name}?{query}" if query else name)

    @property
    def kind(self) -> Kind:
        """The kind of a policy: its prefix, a class to import, or a registered name."""
        prefix, colon, _ = self.name.partition(":")
        return _PREFIXES.get(prefix, "plug-in") if colon else "registered"

    @property
    def place(self) -> str:
        """The part of the name after the prefix: a file, or the name of a reference."""
        return self.name.partition(":")[2]

    def options(self, label: str) -> dict[str, str]:
        """Return the options as texts; see `parse_options`."""
        return parse_options(self.query, label)


def parse_options(query: str, label: str) -> dict[str, str]:
    """Parse ``key=value&key=value`` into a dict; ``label`` names the options' owner in `InputError` messages.

    A plus sign stays a plus sign, as in paths and numbers; percent escapes such as ``%26`` are decoded.
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


def number_text(value: float) -> str:
    """Return the shortest text that parses to the same number: ``2``, ``0.3``, ``17.188733853924695``."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def typed_options(
    label: str,  # owner of the options, as in "scene 'box'"
    factory: Callable[..., Any],
    options: Mapping[str, Any],
    *,
    apart: Collection[str] = (),  # parameters that are not options
    more: Collection[str] = (),  # further options, read by the caller; for messages
) -> dict[str, Any]:
    """Return keyword arguments for ``factory``; texts are converted to the annotated types, other values are passed on.

    Raises `InputError` for an unknown option, a text that cannot be converted, or a missing option without default.
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
    """Return each option's type: its annotation, or else the type of its default."""
    defaults = {
        key: type(p.default)
        for key, p in inspect.signature(factory).parameters.items()
        if isinstance(p.default, bool | int | float)
    }
    takes = factory.__init__ if isinstance(factory, type) else factory  # type: ignore[misc]
    try:
        return {**defaults, **typing.get_type_hints(takes)}
    except (NameError, TypeError):  # names imported only for type checkers, or a callable object
        return defaults


def _typed(what: str, value: Any, hint: Any) -> Any:
    """Convert a text to the annotated type; pass other values on."""
    if not isinstance(value, str):
        return value
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        # Numbers first: "0.01" becomes a number wherever one is allowed; any text is valid as a text.
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
        expected = f"{len(inner)} values with commas" if origin is tuple else getattr(hint, "__name__", str(hint))
        raise InputError(f"{what} must be {expected}, got '{value}'") from None
    return value
