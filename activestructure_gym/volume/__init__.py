"""Map free and occupied space and a TSDF from depth images; provide the distance field for motion planning."""

from activestructure_gym.volume.config import VolumeConfig
from activestructure_gym.volume.integration import FREE, OCCUPIED, UNKNOWN
from activestructure_gym.volume.rays import PixelRays
from activestructure_gym.volume.voxel_volume import VoxelVolume

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "PixelRays", "VolumeConfig", "VoxelVolume"]
