"""Build a map of 3D Gaussians from posed RGB-D frames, and read and write map files."""

from activestructure_gym.mapping.base import BaseMapperConfig, MapperProtocol, MappingReport
from activestructure_gym.mapping.config import MapperConfig
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.keyframe_mapper import KeyframeMapper
from activestructure_gym.mapping.mapper import Mapper
from activestructure_gym.mapping.ply import read_ply, write_ply
from activestructure_gym.mapping.registry import MAPPERS
from activestructure_gym.mapping.tracking import TrackedPose, TrackingConfig, track_pose

__all__ = [
    "MAPPERS",
    "BaseMapperConfig",
    "GaussianMap",
    "KeyframeMapper",
    "Mapper",
    "MapperConfig",
    "MapperProtocol",
    "MappingReport",
    "TrackedPose",
    "TrackingConfig",
    "read_ply",
    "track_pose",
    "write_ply",
]
