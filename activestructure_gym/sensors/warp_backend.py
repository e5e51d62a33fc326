"""Render with the ray caster of NVIDIA Warp (installation extra ``warp``): on the first CUDA device, else on the CPU.

The module is imported only on request. Rays are made and traced on the device. The CPU kernel of ray casting shades
their hits.
"""
# Warp reads the annotations of a kernel as objects, so this file does not postpone them.

import weakref

import numpy as np
import warp as wp

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.scenes.rays import Hits
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.shading import appearance_of, shade_pixels

wp.config.log_level = wp.LOG_ERROR  # Warp warns of a missing CUDA driver, but the CPU is used instead

_FARTHEST = 1e30  # metres
_meshes: dict[int, wp.Mesh] = {}  # by the id of the scene object


@wp.kernel(enable_backward=False)
def _first_hits(
    mesh: wp.uint64,
    origin: wp.vec3,
    rotation: wp.mat33d,  # world from camera
    lens: wp.vec4d,  # fx, fy, cx, cy in pixels
    counts: wp.vec3i,  # width of the image, supersample, rays per pixel
    hits: wp.array2d(dtype=float),  # type: ignore[valid-type]  # [3, N]: distance, u and v of `Hits`
    faces: wp.array(dtype=int),  # type: ignore[valid-type]  # [N]: face of `Hits`
):
    """Trace the rays of `raycast._pixel_rays`, which are computed in float64 as there."""
    ray = wp.tid()
    width, supersample, rays = counts[0], counts[1], counts[2]
    pixel, sub = ray // rays, ray % rays
    beside, below = wp.float64(0.5), wp.float64(0.5)
    if sub < supersample * supersample:
        beside = (wp.float64(sub % supersample) + wp.float64(0.5)) / wp.float64(supersample)
        below = (wp.float64(sub // supersample) + wp.float64(0.5)) / wp.float64(supersample)
    x = (wp.float64(pixel % width) + beside - lens[2]) / lens[0]
    y = (wp.float64(pixel // width) + below - lens[3]) / lens[1]
    direction = wp.vec3(rotation @ wp.vec3d(x, y, wp.float64(1.0)))
    found = wp.mesh_query_ray(mesh, origin, direction, _FARTHEST)
    faces[ray] = -1
    hits[0, ray] = wp.inf
    if found.result:
        faces[ray] = found.face
        hits[0, ray] = found.t
        hits[1, ray] = found.v
        hits[2, ray] = 1.0 - found.u - found.v


class WarpRenderer:
    """Render as `RaycastRenderer` does, with Warp's ray caster; of several faces in one plane, it may show any."""

    name = "warp"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def render(
        self, camera: PinholeCamera, world_from_camera: np.ndarray, *, supersample: int = 2
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render one view; see `Renderer.render`."""
        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, got {supersample}")
        shape, samples = (camera.height, camera.width), supersample * supersample
        rays = samples + 1 - supersample % 2  # the last ray of an even supersample is the pixel's centre
        hits = self.first_hits(camera, world_from_camera, supersample, rays)
        rgb = np.empty((camera.height * camera.width, 3), np.uint8)
        shade_pixels(hits.face, hits.u, hits.v, rays, samples, appearance_of(self._scene), rgb)
        depth = hits.distance[samples // 2 if supersample % 2 else samples :: rays].reshape(shape)
        return rgb.reshape(*shape, 3), np.where(np.isfinite(depth), depth, np.float32(0.0))

    def first_hits(self, camera: PinholeCamera, world_from_camera: np.ndarray, supersample: int, rays: int) -> Hits:
        """Return the first hit of each ray, pixel by pixel, ``rays`` per pixel; distances are depths in metres."""
        mesh, count = _mesh_of(self._scene), camera.width * camera.height * rays
        hits = wp.empty((3, count), dtype=float, device=mesh.device)
        faces = wp.empty(count, dtype=int, device=mesh.device)
        pose = np.asarray(world_from_camera, np.float64)
        wp.launch(
            _first_hits, count, device=mesh.device,
            inputs=[mesh.id, wp.vec3(*pose[:3, 3]), wp.mat33d(*pose[:3, :3].ravel()), wp.vec4d(*camera.lens),
                    wp.vec3i(camera.width, supersample, rays), hits, faces],
        )  # fmt: skip
        distance, u, v = hits.numpy()
        return Hits(distance, faces.numpy(), u, v)

    def close(self) -> None:
        """Do nothing; the mesh on the device belongs to the scene."""


def _mesh_of(scene: Scene) -> wp.Mesh:
    """Return the mesh of a scene on the device, made once per scene object."""
    if id(scene) not in _meshes:
        vertices = wp.array(scene.mesh.vertices, dtype=wp.vec3)
        _meshes[id(scene)] = wp.Mesh(vertices, wp.array(scene.mesh.faces.ravel(), dtype=int))
        weakref.finalize(scene, _meshes.pop, id(scene), None)
    return _meshes[id(scene)]
