"""Render by ray casting, with exact depth, no system libraries, and a cost that hardly depends on the mesh size."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from activestructure_gym.compiling import kernel
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.rasterize import hits_in_rows, triangles_in_image
from activestructure_gym.sensors.shading import appearance_of, shade_pixels

# Approximate number of rays of one band of image rows. Such a band fits into the cache, and one thread casts it, since
# the ray caster splits larger batches over its own pool. Smaller bands would increase Python's overhead.
_RAYS_PER_BAND = 16_000
# A mesh with more triangles per ray is not drawn, since most triangles would cover no sample.
_MAX_FACES_PER_RAY = 16


@kernel
def _pixel_rays(rotation, lens, width, first_row, last_row, supersample, directions):
    """Write the world directions [N, 3] of the rays of the rows ``first_row`` to ``last_row``, pixel by pixel.

    ``rotation`` [3, 3] is world from camera, ``lens`` is fx, fy, cx, cy. A direction has length 1 along the optical
    axis, so that the ray parameter of a hit is its depth. Each pixel has supersample x supersample rays through its
    subpixel centres. If supersample is even, none of them passes through the pixel's centre; one more ray through the
    centre follows.
    """
    fx, fy, cx, cy = lens
    rays = supersample * supersample + 1 - supersample % 2
    across, down = np.empty((width, rays)), np.empty(rays)
    beside, below = np.full(rays, 0.5), np.full(rays, 0.5)  # offsets from the pixel's corner
    for sub in range(supersample * supersample):
        beside[sub] = (sub % supersample + 0.5) / supersample
        below[sub] = (sub // supersample + 0.5) / supersample
    for column in range(width):
        for sub in range(rays):
            across[column, sub] = (column + beside[sub] - cx) / fx
    ray = 0
    for row in range(first_row, last_row):
        for sub in range(rays):
            down[sub] = (row + below[sub] - cy) / fy
        for column in range(width):
            for sub in range(rays):
                x, y = across[column, sub], down[sub]
                for axis in range(3):
                    directions[ray, axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2]
                ray += 1


def default_threads() -> int:
    """Return the default number of rendering threads: 2, or 1 if OMP_NUM_THREADS is 1.

    Set the variable to 1 if every core already runs a job: a second thread then slows down rendering by 10 to 30 %.
    """
    return 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2


class RaycastRenderer:
    """Render with the scene's ray caster; the default renderer.

    Depth comes from one exact ray through each pixel's centre. The image is cut into bands of rows, drawn by
    ``threads`` threads (`default_threads`); the result is the same for any number of threads. Geometry and appearance
    belong to the scene and are shared by all renderers of a process.

    Images of at least ``draws_from`` pixels (None: no image) are drawn triangle by triangle (`rasterize`). This is 1.2
    to 4 times as fast. The first hits are those of the same rays up to rounding: depth differs by about 1e-7 m, and one
    in a million pixels, at the edge of a surface, shows the other surface.
    """

    name = "raycast"

    def __init__(self, scene: Scene, *, threads: int | None = None, draws_from: int | None = None) -> None:
        if threads is None:
            threads = default_threads()
        if threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        self._scene = scene
        self._threads = threads
        self._draws_from = math.inf if draws_from is None else draws_from
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None, "_pool_process": 0}

    def _map(self, function: Any, items: list[Any]) -> None:
        if self._threads == 1 or len(items) == 1:
            for item in items:
                function(item)
            return
        # Threads do not survive a fork: a child process needs a new pool.
        if self._pool is None or self._pool_process != os.getpid():
            self._pool = ThreadPoolExecutor(self._threads)
            self._pool_process = os.getpid()
        for _ in self._pool.map(function, items):
            pass

    def render(
        self, camera: PinholeCamera, world_from_camera: np.ndarray, *, supersample: int = 2
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render one view; see `Renderer.render`."""
        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, got {supersample}")
        appearance, raycaster = appearance_of(self._scene), self._scene.raycaster
        rotation = np.array(world_from_camera[:3, :3], np.float64)
        origin = np.array(world_from_camera[:3, 3], np.float32)
        samples, pixels = supersample * supersample, camera.width * camera.height
        drawn = pixels >= self._draws_from and len(appearance.faces) <= _MAX_FACES_PER_RAY * pixels * samples
        if drawn:
            vertices = np.ascontiguousarray(self._scene.mesh.vertices, np.float32)
            triangles = triangles_in_image(vertices, appearance.faces, camera, world_from_camera)
        rays_per_pixel = samples if drawn else samples + 1 - supersample % 2
        centre = samples // 2 if supersample % 2 else samples
        rgb = np.empty((camera.height, camera.width, 3), np.uint8)
        depth = np.empty((camera.height, camera.width), np.float32)

        def draw(rows: slice) -> None:
            first, last = rows.start, rows.stop
            if drawn:
                hits = hits_in_rows(triangles, first, last, camera.width, supersample)
                distance = (hits if samples == 1 else hits_in_rows(triangles, first, last, camera.width, 1)).distance
            else:
                directions = np.empty(((last - first) * camera.width * rays_per_pixel, 3), np.float32)
                _pixel_rays(rotation, camera.lens, camera.width, first, last, supersample, directions)
                hits = raycaster.cast(origin, directions, fronts=True)
                distance = hits.distance[centre::rays_per_pixel]
            depth[rows] = np.where(np.isfinite(distance), distance, 0.0).reshape(-1, camera.width)
            shade_pixels(hits.face, hits.u, hits.v, rays_per_pixel, samples, appearance, rgb[rows].reshape(-1, 3))

        step = max(1, _RAYS_PER_BAND // (camera.width * rays_per_pixel))
        self._map(draw, [slice(r, min(r + step, camera.height)) for r in range(0, camera.height, step)])
        return rgb, depth

    def close(self) -> None:
        """Stop the rendering threads; a later call of `render` starts new ones."""
        if self._pool is not None and self._pool_process == os.getpid():
            self._pool.shutdown()
        self._pool = None
