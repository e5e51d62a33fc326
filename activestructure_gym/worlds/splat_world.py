"""Make a world of a trained Gaussian splat: the rasteriser renders colour and depth at any pose."""

from __future__ import annotations

import os
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from activestructure_gym.errors import InputError, unknown_name
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.ground_truth import check_start_pose, ground_truth_of
from activestructure_gym.mapping.axes import turned_map
from activestructure_gym.mapping.files import read_map
from activestructure_gym.scenes import load_scene
from activestructure_gym.scenes.loaders.mesh_loader import upright
from activestructure_gym.scenes.loaders.upright import UP_AXES
from activestructure_gym.splatting import cpu
from activestructure_gym.splatting.surface_depth import surface_depth
from activestructure_gym.worlds.base import CaptureFailed, Start, checked_bounds
from activestructure_gym.worlds.frames import frame_from
from activestructure_gym.worlds.registry import WORLDS

_OPAQUE = 0.5  # smallest opacity of a Gaussian that counts as surface
_PERCENTILES, _MARGIN_M = (0.5, 99.5), 0.1  # of the means of opaque Gaussians; the rest are often stray
_SPACING_M, _MOST_PLACES = 0.25, 50_000  # lattice of possible start positions; wider in large maps
_START_CLEARANCE_M = 0.3
_TRIED = 12  # start positions that are rendered
_DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
_CUBE = PinholeCamera.from_size(48, 48)  # one face; 90 degrees


@WORLDS.register("splat")
class SplatWorld:
    """Explore a trained Gaussian map: a 3DGS PLY, the ``map.npz`` of a run, or SplaTAM's ``params.npz``.

    Colours do not depend on the view direction: spherical harmonics above degree 0 are ignored. Depth is that of the
    surface at which half of the light is blocked, 0 where the map is more transparent.

    Without a collision mesh, `capture` renders at every pose. Inside a wall the picture shows the surfaces
    behind the wall, since a splat has no inside. Planned paths stay in space that the depth images show to be
    free. With a collision mesh, `capture` raises `CaptureFailed` at a position that is not in the mesh's free space.

    Parameters
    ----------
    file
        The map.
    width, height, horizontal_fov_deg
        Size of the images in pixels, horizontal field of view in degrees.
    up
        Axis of the file that points up: x, y, z, -x, -y or -z.
    collision
        Mesh file with the same axes as the map. It gives the start, its free radius, and where `capture` fails.
    bounds
        Lowest and highest corner x, y, z, x, y, z in metres, z up. Default: the 0.5 and 99.5 percentiles of the means
        of Gaussians with an opacity of at least 0.5, with a margin of 0.1 m.
    start
        Start position in metres and yaw in degrees: x, y, z, yaw, z up. Default: a start pose of the collision mesh.
        Without a mesh, 12 positions of a lattice are tried. The one from which most directions hit a surface is used,
        with 0.3 m of free space around it and the view direction of the largest median depth.
    background
        Red, green and blue from 0 to 1, where the map is transparent.
    """

    def __init__(
        self,
        file: str,
        *,
        width: int = 160,
        height: int = 90,
        horizontal_fov_deg: float = 90.0,
        up: str = "z",
        collision: str | None = None,
        bounds: tuple[float, float, float, float, float, float] | None = None,
        start: tuple[float, float, float, float] | None = None,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        if up not in UP_AXES:
            raise unknown_name("up axis", up, UP_AXES)
        if not all(0.0 <= value <= 1.0 for value in background):
            raise InputError(f"background is red, green and blue from 0 to 1, got {background}")
        try:
            self.camera = PinholeCamera.from_size(width, height, horizontal_fov_deg)
        except ValueError as error:
            raise InputError(f"this camera cannot be used: {error}") from error
        gaussians = read_map(os.path.expanduser(file))
        self._map = gaussians if up == "z" else turned_map(gaussians, upright(np.eye(3), up).T)
        self._background = np.array(background, dtype=np.float32)
        self._surface = self._map.means[self._map.opacities >= _OPAQUE].astype(np.float64)
        if not len(self._surface):
            raise InputError(f"'{file}' has no Gaussian with an opacity of at least {_OPAQUE}, so it shows no surface")
        if bounds is None:
            low, high = np.percentile(self._surface, _PERCENTILES, axis=0)
            self.bounds = checked_bounds([low - _MARGIN_M, high + _MARGIN_M])
        else:
            self.bounds = checked_bounds([bounds[:3], bounds[3:]])
        self._truth = None if collision is None else ground_truth_of(load_scene(f"mesh:{collision}", up=up))
        self.start = self._found_start() if start is None else self._given_start(start)

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Render a frame at a pose [4, 4]; raise `CaptureFailed` outside the free space of the collision mesh."""
        pose = np.array(world_from_camera, dtype=np.float64)
        if self._truth is not None and not self._truth.free_space.clearance_at(pose[:3, 3])[0] > 0.0:
            raise CaptureFailed(
                f"the position {pose[:3, 3].round(2).tolist()} is not in the collision mesh's free space"
            )
        drawn = cpu.render(self._map.parameters, self._map.count, self.camera, pose)
        colour = np.clip(drawn.color + (1.0 - drawn.alpha)[..., None] * self._background, 0.0, 1.0)
        return frame_from(colour, self._depth(self.camera, pose[None])[0], pose, self.camera)

    def close(self) -> None:
        """Do nothing: the map is held in memory only."""

    def _depth(self, camera: PinholeCamera, poses: np.ndarray) -> np.ndarray:  # [C, 4, 4] -> [C, H, W] metres
        return surface_depth(self._map.parameters, self._map.count, camera, poses)

    def _given_start(self, start: tuple[float, float, float, float]) -> Start:
        position, yaw = np.array(start[:3], dtype=np.float64), np.radians(start[3])
        pose = look_along(position, np.array([np.cos(yaw), np.sin(yaw), 0.0]))
        if self._truth is not None:
            check_start_pose(self._truth, pose, _START_CLEARANCE_M)
            return Start(pose, float(self._truth.free_space.clearance_at(position)[0]))
        free = self._around(position)[0]
        if free < _START_CLEARANCE_M:
            raise InputError(
                f"the start at {position.round(2).tolist()} is {free:.2f} m from the map's surface, and needs "
                f"{_START_CLEARANCE_M} m: choose another one"
            )
        return Start(pose, free)

    def _found_start(self) -> Start:
        """Return a start in the middle of free space; raise `InputError` if there is none."""
        if self._truth is not None:
            pose = self._truth.free_space.start_poses[0]
            return Start(pose, float(self._truth.free_space.clearance_at(pose[:3, 3])[0]))
        spacing = max(_SPACING_M, float(np.cbrt((self.bounds[1] - self.bounds[0]).prod() / _MOST_PLACES)))
        axes = [np.arange(low + 0.5 * spacing, high, spacing) for low, high in self.bounds.T]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        apart = self._tree.query(places)[0]
        # From the farthest to the nearest, so that the 12 positions differ.
        order = np.argsort(-apart, kind="stable")
        order = order[apart[order] >= _START_CLEARANCE_M]
        tried = places[order[np.unique(np.linspace(0, len(order) - 1, min(len(order), _TRIED)).astype(int))]]
        around = [self._around(place) for place in tried]
        good = [n for n, (free, _, _) in enumerate(around) if free >= _START_CLEARANCE_M]
        if not good:
            raise InputError(
                "no position in the map has 0.3 m of free space around it: give start=x,y,z,yaw, or bounds"
            )
        best = max(good, key=lambda n: (round(around[n][1], 2), around[n][0]))
        return Start(look_along(tried[best], around[best][2]), around[best][0])

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._surface)

    def _around(self, position: np.ndarray) -> tuple[float, float, np.ndarray]:
        """Render the six sides of a cube around a position [3].

        Return the distance to the nearest surface in metres, the share of directions with a surface, and the
        horizontal direction [3] with the largest median depth.
        """
        poses = np.stack([look_along(position, direction) for direction in _DIRECTIONS])
        depth = self._depth(_CUBE, poses)
        distance = depth * np.linalg.norm(_CUBE.rays(), axis=-1)
        hit = depth > 0.0
        nearest = min(float(distance[hit].min(initial=np.inf)), float(self._tree.query(position)[0]))
        ahead = [float(np.median(side[side > 0.0])) if (side > 0.0).any() else 0.0 for side in depth[:4]]
        return min(nearest, 100.0), float(hit.mean()), _DIRECTIONS[int(np.argmax(ahead))]
