"""Map free and occupied space and a TSDF from depth images; provide the distance field for motion planning."""

from activestructure_gym.volume.integration import FREE, OCCUPIED, UNKNOWN
from activestructure_gym.volume.voxel_volume import VolumeConfig, VoxelVolume

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "VolumeConfig", "VoxelVolume"]
