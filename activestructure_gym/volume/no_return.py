"""Record the voxels that rays without a return crossed.

Such rays pass through a window, the open side of a scene, or a crack narrower than a voxel. Dark and mirroring surfaces
return nothing either. In all these cases further views rarely find a surface there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry.camera import Lens


class Grid(NamedTuple):
    """Hold the voxels that rays cross."""

    state: np.ndarray  # [X, Y, Z]
    crossed: np.ndarray  # [X, Y, Z] bool
    origin: np.ndarray  # [3] metres, lower corner of voxel (0, 0, 0)
    voxel_size: float  # metres


@kernel
def mark_crossed(
    grid: Grid,  # voxels on the rays of the empty pixels are set to True in ``crossed``
    empty: np.ndarray,  # [H, W] bool: pixels without a return up to ``reach``
    stride: int,  # pixels from one traced ray to the next, in both directions
    lens: Lens,
    world_from_camera: np.ndarray,  # [4, 4]
    reach: float,  # metres of depth
    end: int,  # state of the voxels at which a ray ends
) -> None:
    """Mark the voxels on the rays of the empty pixels, in steps of half a voxel, up to ``end`` or the grid's border."""
    state, crossed, origin, voxel_size = grid
    fx, fy, cx, cy = lens
    pose, step = world_from_camera, 0.5 * voxel_size
    for v in range(0, empty.shape[0], stride):
        for u in range(0, empty.shape[1], stride):
            if not empty[v, u]:
                continue
            x, y = (u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy
            length = np.sqrt(x * x + y * y + 1.0)
            dx = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]) * 0.5 / length
            dy = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]) * 0.5 / length
            dz = (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]) * 0.5 / length
            x, y, z = (pose[:3, 3] - origin) / voxel_size
            for _ in range(int(reach * length / step)):
                x, y, z = x + dx, y + dy, z + dz
                i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
                if i < 0 or j < 0 or k < 0 or i >= crossed.shape[0] or j >= crossed.shape[1] or k >= crossed.shape[2]:
                    break
                if state[i, j, k] == end:
                    break
                crossed[i, j, k] = True
