"""Which distributions the package asks for, from setup.cfg and the metadata of what is installed."""

from __future__ import annotations

import configparser
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]


def extras() -> list[str]:
    """The names of our extras."""
    return list(_setup()["options.extras_require"])


def ours(*names: str) -> list[Requirement]:
    """What the package asks for, and these extras of it."""
    setup = _setup()
    lists = [setup["options"]["install_requires"], *(setup["options.extras_require"][name] for name in names)]
    return [Requirement(line) for text in lists for line in text.split("\n") if line.strip()]


def closure(requirements: Iterable[Requirement]) -> dict[str, set[str]]:
    """The names of all distributions that these need here, with the extras that are asked of each.

    What a distribution needs that is not installed is not known.
    """
    found: dict[str, set[str]] = {}
    ahead = list(requirements)
    while ahead:
        wanted = ahead.pop()
        if wanted.marker is not None and not wanted.marker.evaluate({"extra": ""}):
            continue
        name = canonicalize_name(wanted.name)
        new = name not in found
        extras = set(wanted.extras) - found.setdefault(name, set())
        found[name] |= extras
        try:
            lines = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue
        for inner in map(Requirement, lines):
            of_extra = inner.marker is not None and not inner.marker.evaluate({"extra": ""})
            if of_extra and any(inner.marker.evaluate({"extra": extra}) for extra in extras):  # type: ignore[union-attr]
                inner.marker = None
                ahead.append(inner)
            elif not of_extra and new:
                ahead.append(inner)
    return found


def _setup() -> configparser.ConfigParser:
    config = configparser.ConfigParser()
    config.optionxform = str  # type: ignore[assignment, method-assign]
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    return config
