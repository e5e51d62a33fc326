"""The Gaussian map, the mapper that grows it from posed RGB-D frames, and its files."""

from activestructure_gym.mapping.config import MAPPERS, MapperConfig
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.mapper import Mapper, MappingReport
from activestructure_gym.mapping.ply import read_ply, write_ply
from activestructure_gym.mapping.tracking import TrackedPose, TrackingConfig, track_pose

__all__ = [
    "MAPPERS",
    "GaussianMap",
    "Mapper",
    "MapperConfig",
    "MappingReport",
    "TrackedPose",
    "TrackingConfig",
    "read_ply",
    "track_pose",
    "write_ply",
]
