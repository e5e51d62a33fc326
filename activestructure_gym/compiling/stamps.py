"""Stamps of kernels: one number for all sources that a kernel's machine code was made from.

numba builds into a kernel whatever its functions call and every constant that they read, from whichever file. So a
stamp covers, however many calls away from the kernel,

- the text of every file with a function or an intrinsic that the kernel calls, or with a class that it names;
- the value of every constant, wherever it was imported from;
- the options that the functions were compiled with.

A file counts as a whole: what else stands in it (how an operator is compiled, say) can matter, too. Functions that
belong to no package of the kernel's own count only if they are compiled functions: what numba makes of numpy's comes
with numba.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections.abc import Iterable, Iterator
from enum import Enum
from functools import lru_cache, partial
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

_BEGAN = time.time()  # files that have changed since may hold another text than this process runs
_OURS = __name__.partition(".")[0]
_PLAIN = (bool, int, float, complex, str, bytes, type(None), np.generic)


def stamp_of(function: FunctionType) -> bytes | None:  # 32 bytes
    """A digest of everything that the machine code of ``function`` depends on.

    None if one of the files has changed since this process loaded it: then what is compiled here is not what the files
    say, and must not be kept.
    """
    files, facts = _dependencies(function)
    digest = hashlib.sha256()
    for file in sorted(files):
        content = _digest_of_file(file)
        if content is None:
            return None
        digest.update(content)
    for fact in sorted(facts):
        digest.update(fact.encode() + b"\n")
    return digest.digest()


def identity_of(function: FunctionType) -> str:
    """A text that differs for functions that one ``def`` made from different closure values."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or ())
    return "; ".join(f"{name}={_plain_text(cell.cell_contents)}" for name, cell in cells)


def files_of(function: FunctionType) -> set[str]:
    """The source files that a kernel depends on."""
    return _dependencies(function)[0]


def _dependencies(function: FunctionType) -> tuple[set[str], set[str]]:
    """The source files that ``function`` depends on, and what else it depends on, in words."""
    packages = {_OURS, function.__module__.partition(".")[0]}
    files, facts = set[str](), set[str]()
    seen, ahead = set[int](), [function]
    while ahead:
        function = ahead.pop()
        if id(function) in seen:
            continue
        seen.add(id(function))
        file = function.__code__.co_filename
        if os.path.exists(file):
            files.add(file)
        else:  # installed without sources, or typed in
            facts.add(f"{function.__qualname__} {_code_text(function.__code__)}")
        for name, value in _references(function):
            for label, part in _parts(name, value):
                inner = _compiled_from(part)
                if inner is not None:
                    facts.add(f"{inner.__qualname__} {_options(part)}")
                    ahead.append(inner)
                elif isinstance(part, FunctionType):
                    if _package(part) in packages:
                        ahead.append(part)
                else:
                    facts.add(f"{function.__module__}.{function.__qualname__} {label} {_plain_text(part)}")
                    kind = part if isinstance(part, type) else type(part)
                    if _package(kind) in packages:
                        files |= _file_of_class(kind)
    return files, facts


def _references(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Names and values of what a function refers to outside of itself."""
    names = _names_in(function.__code__)
    for name in names:
        if name in function.__globals__:
            yield from _attributes(name, function.__globals__[name], names, 3)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or ()):
        try:
            yield from _attributes(name, cell.cell_contents, names, 3)
        except ValueError:  # empty: a function that calls itself, still being made
            pass
    for value in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
        yield "default", value


def _attributes(name: str, value: Any, names: Iterable[str], depth: int) -> Iterator[tuple[str, Any]]:
    """The value, or of a module what a function with these names can read from it."""
    if not isinstance(value, ModuleType):
        yield name, value
    elif depth:
        inside = vars(value)
        for attribute in names:
            if attribute in inside and inside[attribute] is not value:
                yield from _attributes(f"{name}.{attribute}", inside[attribute], names, depth - 1)


@lru_cache(None)
def _names_in(code: CodeType) -> tuple[str, ...]:
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names.update(_names_in(constant))
    return tuple(sorted(names))


def _parts(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """A value, or what it is made of."""
    if isinstance(value, (tuple, list)) and not all(isinstance(part, _PLAIN) for part in value):
        for index, part in enumerate(value):
            yield from _parts(f"{name}[{index}]", part)
    elif isinstance(value, partial):
        yield from _parts(name, (value.func, *value.args, *value.keywords.values()))
    else:
        yield name, value


def _compiled_from(value: Any) -> FunctionType | None:
    """The Python function behind a compiled function or an intrinsic of numba."""
    if _package(type(value)) != "numba":
        return None
    for attribute in ("py_func", "_defn"):
        function = getattr(value, attribute, None)
        if isinstance(function, FunctionType):
            return function
    return None


def _options(compiled: Any) -> str:
    options = getattr(compiled, "targetoptions", {})
    return ", ".join(f"{name}={_plain_text(options[name])}" for name in sorted(options))


def _plain_text(value: Any) -> str:
    """A text of ``value`` that is the same in every process; for a value without a plain form, its name."""
    if isinstance(value, (type, FunctionType)):
        return f"{value.__module__}.{value.__qualname__}"
    if isinstance(value, _PLAIN) and not isinstance(value, Enum):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, Enum):
        return f"{_plain_text(type(value))} {value.name} {_plain_text(value.value)}"
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"array {value.dtype} {value.shape} {content}"
    if isinstance(value, (tuple, list)):
        return f"{_plain_text(type(value))} ({', '.join(map(_plain_text, value))})"
    inner = _compiled_from(value)
    if inner is not None:
        return _plain_text(inner)
    if _package(type(value)) in ("numba", "numpy"):  # types, dtypes
        return f"{_plain_text(type(value))} {value}".partition(" at 0x")[0]
    return _plain_text(type(value))


def _package(thing: Any) -> str:
    return str(getattr(thing, "__module__", None)).partition(".")[0]


@lru_cache(None)
def _file_of_class(kind: type) -> frozenset[str]:
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return frozenset([file] if file and os.path.exists(file) else [])


def _code_text(code: CodeType) -> str:
    constants = [_code_text(value) if isinstance(value, CodeType) else repr(value) for value in code.co_consts]
    return f"{code.co_code.hex()} {code.co_names} {constants}"


@lru_cache(None)
def _digest_of_file(file: str) -> bytes | None:
    """Digest of a file's text; None if the file has changed since this process began."""
    with open(file, "rb") as source:
        about = os.fstat(source.fileno())
        if _BEGAN < max(about.st_mtime, about.st_ctime) <= time.time():
            return None
        return hashlib.sha256(source.read()).digest()
