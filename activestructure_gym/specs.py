"""Parse names with options: ``apartment?seed=3&rooms=4``, ``naruto?travel=shared``.

What an option may be is read from the function or class that takes it: its parameters and their annotations.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Collection, Mapping
from types import UnionType
from typing import Any
from urllib.parse import parse_qsl

from activestructure_gym.errors import InputError, unknown_name


def parse_options(query: str, label: str) -> dict[str, str]:
    """``key=value&key=value`` as a dict; ``label`` names whose options they are. Raises `InputError`.

    A plus is a plus, as in paths and numbers; ``%26`` and the like are the characters that they stand for.
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
    """The number as short as can be without becoming another one: ``2``, ``0.3``, ``17.188733853924695``."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def typed_options(
    label: str,  # of whom, as in "scene 'box'"
    factory: Callable[..., Any],
    options: Mapping[str, Any],
    *,
    apart: Collection[str] = (),  # parameters that are no options
    more: Collection[str] = (),  # options that the caller reads itself, for messages
) -> dict[str, Any]:
    """Keyword arguments for ``factory``; texts are read as its annotations say, other values are passed on.

    Raises `InputError` for a name that is not among its parameters, for a text that cannot be what is annotated, and
    for a parameter without a default that is not given.
    """
    parameters = {key: p for key, p in inspect.signature(factory).parameters.items() if key not in apart}
    takes_any = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    known = [key for key, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    if options and not known and not more and not takes_any:
        given = "&".join(f"{key}={value}" for key, value in options.items())
        raise InputError(f"{label} takes no options, got '{given}'; leave them away")
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
    """The type of every option: its annotation, or that of its default where there is none to be had."""
    defaults = {
        key: type(p.default)
        for key, p in inspect.signature(factory).parameters.items()
        if isinstance(p.default, bool | int | float)
    }
    takes = factory.__init__ if isinstance(factory, type) else factory  # type: ignore[misc]
    try:
        return {**defaults, **typing.get_type_hints(takes)}
    except (NameError, TypeError):  # names imported for type checkers only, or a callable object
        return defaults


def _typed(what: str, value: Any, hint: Any) -> Any:
    """A text value as its annotation says; values that are no text are passed on."""
    if not isinstance(value, str):
        return value
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, UnionType):
        # Numbers first: "0.01" is a number wherever a number may stand, and any text is a text.
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
