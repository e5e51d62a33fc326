"""The mapper that a configuration names."""

from __future__ import annotations

import numpy as np

from activestructure_gym.mapping.config import CoSLAMConfig, GaussianSLAMConfig, MapperConfig, MonoGSConfig
from activestructure_gym.mapping.mapper import Mapper


def make_mapper(
    config: MapperConfig,
    rng: np.random.Generator,
    bounds: np.ndarray,  # [2, 3] metres, the box that everything lies in
) -> Mapper:
    """An empty mapper; systems that step by torch load it only here."""
    if isinstance(config, MonoGSConfig):
        from activestructure_gym.mapping.monogs import MonoGSMapper

        return MonoGSMapper(config, rng)
    if isinstance(config, GaussianSLAMConfig):
        from activestructure_gym.mapping.gaussian_slam import GaussianSLAMMapper

        return GaussianSLAMMapper(config, rng)
    if isinstance(config, CoSLAMConfig):
        from activestructure_gym.mapping.co_slam import CoSLAMMapper

        return CoSLAMMapper(config, rng, bounds)
    return Mapper(config, rng)
