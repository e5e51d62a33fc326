"""The mapper that a configuration names."""

from __future__ import annotations

import numpy as np

from activestructure_gym.mapping.config import GaussianSLAMConfig, MapperConfig, MonoGSConfig
from activestructure_gym.mapping.mapper import Mapper


def make_mapper(config: MapperConfig, rng: np.random.Generator) -> Mapper:
    """An empty mapper; systems that step by torch load it only here."""
    if isinstance(config, MonoGSConfig):
        from activestructure_gym.mapping.monogs import MonoGSMapper

        return MonoGSMapper(config, rng)
    if isinstance(config, GaussianSLAMConfig):
        from activestructure_gym.mapping.gaussian_slam import GaussianSLAMMapper

        return GaussianSLAMMapper(config, rng)
    return Mapper(config, rng)
