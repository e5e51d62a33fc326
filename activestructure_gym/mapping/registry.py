"""Register mappers by name. An entry is the configuration class or object that creates the mapper."""

from __future__ import annotations

from dataclasses import replace

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
    """Return the configuration registered as ``name``, with its field ``name`` set to ``name``.

    Raises `InputError` for an unknown name, and for an entry that is not the configuration of a mapper.
    """
    entry = MAPPERS.get(name)
    return replace(entry() if isinstance(entry, type) else entry, name=name)
