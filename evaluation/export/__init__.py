"""Write finished runs for other programs: posed pictures for offline training, poses, and the surface as a mesh."""

from activestructure_gym.evaluation.export.dataset import write_colmap, write_nerfstudio
from activestructure_gym.evaluation.export.frames import PosedFrames, posed_frames
from activestructure_gym.evaluation.export.surface import surface_mesh, write_mesh
from activestructure_gym.evaluation.export.tum import write_tum

__all__ = [
    "PosedFrames",
    "posed_frames",
    "surface_mesh",
    "write_colmap",
    "write_mesh",
    "write_nerfstudio",
    "write_tum",
]
