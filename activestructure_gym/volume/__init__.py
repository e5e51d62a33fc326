"""Occupancy and TSDF from depth images, and the distance field that all motion is planned on."""

from activestructure_gym.volume.integration import FREE, OCCUPIED, UNKNOWN
from activestructure_gym.volume.voxel_volume import VolumeConfig, VoxelVolume

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "VolumeConfig", "VoxelVolume"]
