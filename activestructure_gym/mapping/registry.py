"""The mappers by name: each entry is the configuration of a mapper, which makes it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from activestructure_gym.mapping.base import BaseMapperConfig
from activestructure_gym.registry import Registry


def _fits(entry: object) -> bool:
    return isinstance(entry, BaseMapperConfig) or (isinstance(entry, type) and issubclass(entry, BaseMapperConfig))


MAPPERS: Registry[BaseMapperConfig | type[BaseMapperConfig]] = Registry(
    "mapper",
    "mappers",
    fits=_fits,
    wanted="a BaseMapperConfig",
    files=("mapping/config.py", "mapping/systems/*/config.py"),
)


def mapper_config(name: str) -> BaseMapperConfig:
    """Return the configuration called ``name``; its field ``name`` is that name.

    Raises `InputError` for an unknown name, or an entry that is no mapper's configuration.
    """
    entry = MAPPERS.get(name)
    return replace(entry() if isinstance(entry, type) else entry, name=name)


def mapper_names(overrides: Mapping[str, Any]) -> Iterator[str]:
    """Yield the mapper's name in overrides of a configuration, nested or with dots, if there is one."""
    nested = overrides.get("mapper")
    for name in (overrides.get("mapper.name"), nested.get("name") if isinstance(nested, Mapping) else None):
        if isinstance(name, str):
            yield name
