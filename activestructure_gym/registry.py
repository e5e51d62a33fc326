"""Register policies, features and scenes by name.

A name is looked up in this order:

- entries registered in this process;
- ``"family:rest"``: a family makes the entry from ``rest`` (``learned:CHECKPOINT``);
- ``"package.module:attribute"``, imported; works in worker processes without registering;
- files of this package that the registry names by a pattern (``policies/*/features.py``), imported;
- entry points of installed packages in the group ``activestructure_gym.<kind>``, which ``pip install`` adds.
"""

from __future__ import annotations

import difflib
import importlib
import os
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar

from activestructure_gym.errors import InputError, short_repr, unknown_name

TRUST = "ASG_TRUST_CODE"  # if set to 1, files may name code to import; workers inherit the variable

T = TypeVar("T")
Maker = TypeVar("Maker", bound=Callable[[str], Any])


@cache  # reading the metadata of all installed packages takes some 20 ms
def installed(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group in the installed packages."""
    return tuple(entry_points(group=group))


class Registry(Generic[T]):
    """Map names to objects of one ``kind``; ``plural`` names the group of entry points.

    `get` refuses an entry for which ``fits`` is false; the message says that it must be ``wanted``.
    ``files`` are patterns ``ROOM/PATTERN`` of this package's files that register entries here. They are imported when
    all names are asked for, or one that is not registered.
    """

    def __init__(
        self,
        kind: str,
        plural: str,
        *,
        fits: Callable[[Any], bool] = lambda _: True,
        wanted: str = "anything",
        files: tuple[str, ...] = (),
    ) -> None:
        self.kind = kind
        self.group = f"activestructure_gym.{plural}"
        self._fits, self._wanted, self._files = fits, wanted, files
        self._entries: dict[str, T] = {}
        self._families: dict[str, Callable[[str], T]] = {}

    def register(self, name: str) -> Callable[[T], T]:
        """Return a decorator, as in ``@POLICIES.register("mine")``. It replaces an entry of the same name."""

        def remember(entry: T) -> T:
            self._entries[name] = entry
            return entry

        return remember

    def register_family(self, name: str) -> Callable[[Maker], Maker]:
        """Return a decorator for a function that makes the entry of ``name:rest`` from ``rest``."""

        def remember(make: Maker) -> Maker:
            self._families[name] = make
            return make

        return remember

    def __iter__(self) -> Iterator[str]:
        self._import_files()
        return iter(sorted(self._entries.keys() | {point.name for point in installed(self.group)}))

    def __contains__(self, name: object) -> bool:
        return name in self._entries or name in set(self)

    def get(self, name: str) -> T:
        """Return the object called ``name``; raise `InputError` naming the nearest known name."""
        if not isinstance(name, str):
            raise InputError(f"a {self.kind} is given by its name, as a text, got {short_repr(name)}")
        entry = self._find(name)
        if not self._fits(entry):
            raise InputError(f"{self.kind} '{name}' must be {self._wanted}, got {short_repr(entry)}")
        return entry

    def imports(self, name: str) -> bool:
        """Return whether `get` would import the module named by ``name`` and so run its code."""
        family, colon, _ = name.partition(":")
        if colon and name not in self._entries:
            self._import_files()
        return bool(colon) and name not in self._entries and family not in self._families

    def module_of(self, name: str) -> str | None:
        """Return the module that ``name`` refers to by path or entry point, without importing it.

        None for entries of this package.
        """
        ours = __name__.partition(".")[0]
        if self.imports(name):
            module = name.partition(":")[0]
            return None if module.partition(".")[0] == ours else module
        entry = self._entries.get(name)
        # for a feature: the module of its function
        made_in = getattr(getattr(entry, "compute", entry), "__module__", "")
        if made_in.partition(".")[0] == ours:
            return None
        return next((point.module for point in installed(self.group) if point.name == name), None)

    def _find(self, name: str) -> T:
        if name in self._entries:
            return self._entries[name]
        if self.imports(name):
            return self._import(name)
        family, colon, rest = name.partition(":")
        if colon:
            return self._families[family](rest)
        self._import_files()
        if name in self._entries:
            return self._entries[name]
        for point in installed(self.group):
            if point.name == name:
                return self._entries.setdefault(name, point.load())
        raise unknown_name(self.kind, name, self)

    def _import_files(self) -> None:
        """Import the files of this package that register entries here."""
        ours = __name__.partition(".")[0]
        for room, _, pattern in (file.partition("/") for file in self._files):
            package = f"{ours}.{room}"
            for folder in map(Path, importlib.import_module(package).__path__):
                for file in sorted(folder.glob(pattern)):
                    importlib.import_module(".".join((package, *file.relative_to(folder).with_suffix("").parts)))

    def _import(self, path: str) -> T:
        module_name, _, attribute = path.partition(":")
        if not module_name.replace(".", "_").isidentifier() or not attribute.isidentifier():
            raise InputError(f"{self.kind} '{path}' is neither a known name nor of the form package.module:Name")
        try:
            module = importlib.import_module(module_name)
        except ModuleNotFoundError as error:
            hint = f"; without .py it is {path.replace('.py:', ':', 1)}" if ".py:" in path else ""
            raise InputError(
                f"{self.kind} '{path}': there is no module called '{error.name}' on sys.path{hint}"
            ) from error
        except SyntaxError as error:
            where = f"'{error.filename}', line {error.lineno}"
            raise InputError(f"{self.kind} '{path}' cannot be imported: {where}: {error.msg}") from error
        try:  # not inside the first try: an AttributeError within the module must reach its author
            return getattr(module, attribute)
        except AttributeError as error:
            names = [name for name in dir(module) if not name.startswith("_")]
            close = difflib.get_close_matches(attribute, names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            # may be another file than meant, such as one of the standard library
            file = getattr(module, "__file__", None)
            where = f", which is {file}," if file else ""
            raise InputError(
                f"{self.kind} '{path}': module '{module_name}'{where} has no '{attribute}'{hint}"
            ) from error


def refuse_code(kind: str, name: str, file: object) -> None:
    """Raise `InputError` if a ``name`` read from a ``file`` would import code, unless files are trusted.

    A name typed by the user may import any module. A file may come from anyone, so its names are limited to registered
    entries and data.
    """
    if os.environ.get(TRUST) != "1":
        raise InputError(
            f"'{file}' names the {kind} {short_repr(name)}, and to load it would run code of that name: if you know "
            f"who wrote the file and trust it, add --trust-code (or set {TRUST}=1)"
        )
