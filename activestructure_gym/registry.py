"""Map names to policies, features, scenes and other objects.

A name is looked up in this order:

- entries registered in this process;
- ``"family:rest"``: the function registered for this family makes the entry from ``rest`` (``learned:CHECKPOINT``);
- ``"package.module:attribute"``: imported; works in worker processes without registering;
- files of this package that match a pattern of the registry (``policies/*/features.py``): imported, they register
  entries;
- entry points of installed packages in the group ``activestructure_gym.<kind>``, which ``pip install`` adds.
"""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar

from activestructure_gym.errors import InputError, short_repr, unknown_name

TRUST = "ASG_TRUST_CODE"  # environment variable; with 1, files may name code to import; worker processes inherit it

T = TypeVar("T")
Maker = TypeVar("Maker", bound=Callable[[str], Any])


@cache  # reading the metadata of all installed packages takes about 20 ms
def installed(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points that installed packages define in a group."""
    return tuple(entry_points(group=group))


class Registry(Generic[T]):
    """Map names to objects of one ``kind``; the group of entry points is ``activestructure_gym.`` + ``plural``.

    `get` raises `InputError` for an entry for which ``fits`` returns False; the message says that it must be
    ``wanted``. ``files`` are patterns ``ROOM/PATTERN`` of files in this package that register entries. These files are
    imported when all names are listed or an unregistered name is looked up.
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
        """Return a decorator that registers an object, as in ``@POLICIES.register("mine")``.

        A module that is executed again replaces its own entry. Raise `InputError` if ``name`` is no text, or if another
        file has registered it: names of features and policies select what a run computes.
        """
        if not isinstance(name, str):
            raise InputError(f"register takes a name, as in @register('mine'), got {short_repr(name)}")

        def remember(entry: T) -> T:
            before, now = self._made_in(name), _module_of(entry)
            if before != now and _file_of(before) != _file_of(now) and name in self._entries:
                raise InputError(
                    f"the {self.kind} '{name}' of the module {now} is already registered by {before}: give it another "
                    "name"
                )
            self._entries[name] = entry
            return entry

        return remember

    def register_family(self, name: str) -> Callable[[Maker], Maker]:
        """Return a decorator for a function that makes the entry of ``name:rest`` from the text ``rest``."""

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
        """Return the object called ``name``.

        Raises `InputError`, with the nearest known name, if there is none.
        """
        if not isinstance(name, str):
            raise InputError(f"a {self.kind} is given by its name, as a text, got {short_repr(name)}")
        entry = self._find(name)
        if not self._fits(entry):
            raise InputError(f"{self.kind} '{name}' must be {self._wanted}, got {short_repr(entry)}")
        return entry

    def imports(self, name: str) -> bool:
        """Return whether `get` would import the module in ``name`` (``package.module:attribute``) and run its code."""
        family, colon, _ = name.partition(":")
        if colon and name not in self._entries:
            self._import_files()
        return bool(colon) and name not in self._entries and family not in self._families

    def module_of(self, name: str) -> str | None:
        """Return the module outside this package that a path or entry point gives for ``name``, without importing it.

        None if there is no such module, or if the entry is from this package.
        """
        if self.imports(name):
            module = name.partition(":")[0]
            return None if _is_ours(module) else module
        if _is_ours(self._made_in(name)):
            return None
        return next((point.module for point in installed(self.group) if point.name == name), None)

    def only_here(self, name: str) -> str | None:
        """Return the module outside this package that registered ``name`` in this process; other processes lack it.

        None if this package or an entry point has the name.
        """
        made_in = self._made_in(name)
        lasting = _is_ours(made_in) or name in {point.name for point in installed(self.group)}
        return None if lasting else made_in or None

    def _made_in(self, name: str) -> str:
        """Return the module in which the entry ``name`` is defined; empty if there is none in this process."""
        return _module_of(self._entries.get(name))

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
        """Import the files of this package that register entries in this registry."""
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
        try:  # a separate try, because an AttributeError raised inside the module must reach its author
            return getattr(module, attribute)
        except AttributeError as error:
            names = [name for name in dir(module) if not name.startswith("_")]
            close = difflib.get_close_matches(attribute, names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            # The file is named because it may not be the intended one, for example one of the standard library.
            file = getattr(module, "__file__", None)
            where = f", which is {file}," if file else ""
            raise InputError(
                f"{self.kind} '{path}': module '{module_name}'{where} has no '{attribute}'{hint}"
            ) from error


def _module_of(entry: Any) -> str:
    """Return the name of the module in which an entry is defined; empty if it has none."""
    # The function of a feature is its attribute ``compute``.
    return getattr(getattr(entry, "compute", entry), "__module__", None) or ""


def _file_of(module: str) -> str | None:
    """Return the file of an imported module: one file can be ``__main__`` and a module of its own name."""
    return getattr(sys.modules.get(module), "__file__", None)


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] == __name__.partition(".")[0]


def refuse_code(kind: str, name: str, file: object) -> None:
    """Raise `InputError` for a ``name`` from a ``file`` that would import code, unless the user trusts files.

    A name typed by the user may import any module. A file may come from an unknown author, so its names are limited to
    registered entries and data.
    """
    if os.environ.get(TRUST) != "1":
        raise InputError(
            f"'{file}' names the {kind} {short_repr(name)}, and to load it would run code of that name: if you know "
            f"who wrote the file and trust it, add --trust-code (or set {TRUST}=1)"
        )
