"""Explore a MuJoCo model with a free RGB-D camera that MuJoCo's own renderer draws."""

from __future__ import annotations

import os
import weakref
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.directions import fibonacci_directions
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.worlds.base import Start, checked_bounds, checked_pose
from activestructure_gym.worlds.egl import REPAIR, EGLContext
from activestructure_gym.worlds.registry import WORLDS

if TYPE_CHECKING:
    import mujoco

_SAMPLES = 3  # colour samples per pixel and axis; odd, so that one sample is at the pixel's centre
_NEAR = 0.05  # near clipping plane, metres
_MAX_GEOMS = 20_000
_SHADOW_SIZE = 1024  # largest shadow map in pixels; a CPU needs 0.5 s for 4096
_SHOWN_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)  # geom groups that MuJoCo draws by default
_DRAWS, _PLACES, _RAYS = 100, 16, 300  # places tried, places kept, rays per place
_CLEARANCE, _LEAST_CLEARANCE = 0.6, 0.3  # metres wanted and needed around a start
_BETWEEN = 0.9  # share of the shortest ray that counts as clearance: corners may be between two rays
_FREE = 10.0  # metres: largest free radius of a start


@WORLDS.register("mujoco")
class MujocoWorld:
    """Explore a MuJoCo model in its current state, with a camera that has no body.

    MuJoCo draws its lights, shadows and reflections. The sky is black and without depth. Sites are not drawn.

    Parameters
    ----------
    model
        MJCF or URDF file, or a ``mujoco.MjModel``.
    width, height
        Size of the images in pixels.
    fovy
        Vertical field of view in degrees.
    start
        Position x, y, z in metres and yaw in degrees. Default: `reset` draws one of 16 places with 0.6 m of clearance,
        measured by 300 rays each. The camera then looks at the middle of the bounds.
    bounds
        Lowest and highest corner in metres, as 6 numbers. Default: the box around all geoms that are drawn. Infinite
        planes only lower its floor.
    data
        A ``mujoco.MjData`` of the model, drawn as it is at each frame. Default: the model's initial state.

    Raises
    ------
    InputError
        Without the package or OpenGL, for a file that is no model, and if no free start is found.
    """

    def __init__(
        self,
        model: str | Any,
        *,
        width: int = 160,
        height: int = 90,
        fovy: float = 60.0,
        start: tuple[float, float, float, float] | None = None,
        bounds: tuple[float, float, float, float, float, float] | None = None,
        data: Any = None,
    ) -> None:
        if width < 1 or height < 1 or not 0.0 < fovy < 180.0:
            raise InputError(
                f"a camera needs a width and height of at least 1 pixel and a fovy between 0 and 180 degrees, got "
                f"{width} x {height} pixels and {fovy:g} degrees"
            )
        self._mujoco = _package()
        self.model = _loaded(self._mujoco, model)
        self.data = self._mujoco.MjData(self.model) if data is None else data
        if data is None:
            self._mujoco.mj_forward(self.model, self.data)
        focal = 0.5 * height / float(np.tan(np.radians(fovy) / 2.0))
        self.camera = PinholeCamera(width, height, focal, focal, width / 2.0, height / 2.0)
        self.bounds = self._box_of_geoms() if bounds is None else checked_bounds([bounds[:3], bounds[3:]])
        self._starts = self._found_starts() if start is None else [self._given_start(start)]
        self._drawing = _Drawing(self._mujoco, self.model, (_SAMPLES * width, _SAMPLES * height))
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Draw the start from the seed."""
        self.start = self._starts[np.random.default_rng(seed).integers(len(self._starts))]

    def capture(self, world_from_camera: np.ndarray) -> Frame:
        """Draw a frame at a pose [4, 4]."""
        pose = checked_pose("the pose of a capture", world_from_camera)
        rgb, depth = self._drawing.draw(self.data, pose, self.camera)
        middle = _SAMPLES // 2
        rgb = cv2.resize(rgb, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)
        return Frame(rgb, np.ascontiguousarray(depth[middle::_SAMPLES, middle::_SAMPLES]), pose, self.camera)

    def close(self) -> None:
        """Release the OpenGL context."""
        self._drawing.close()

    def _box_of_geoms(self) -> np.ndarray:  # [2, 3]
        """Return the box around the geoms that are drawn; raise `InputError` for a model without them."""
        model, data, planes = self.model, self.data, self._mujoco.mjtGeom.mjGEOM_PLANE
        shown = _drawn(model)
        endless = model.geom_type == planes
        corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        boxes = [
            data.geom_xpos[n] + (centre + corners * half) @ data.geom_xmat[n].reshape(3, 3).T
            for n, centre, half in zip(range(model.ngeom), model.geom_aabb[:, :3], model.geom_aabb[:, 3:])
            if shown[n] and not endless[n]
        ]
        if not boxes:
            raise InputError("the model has no geoms to take bounds from: give bounds=x,y,z,x,y,z in metres")
        points = np.concatenate(boxes)
        low, high = points.min(axis=0), points.max(axis=0)
        level = endless & shown & (data.geom_xmat[:, 8] > 0.99)
        low[2] = min([low[2], *data.geom_xpos[level, 2]])
        return checked_bounds(np.stack([low, high]))

    def _given_start(self, start: tuple[float, float, float, float]) -> Start:
        position = np.array(start[:3], dtype=np.float64)
        clearance, _ = self._room_at(position)
        if clearance <= 0.0:
            raise InputError(f"the start at {position.tolist()} is inside a geom of the model: give another one")
        yaw = np.radians(start[3])
        return Start(look_along(position, np.array([np.cos(yaw), np.sin(yaw), 0.0])), min(clearance, _FREE))

    def _found_starts(self) -> list[Start]:
        """Return the places with enough clearance from which the fewest rays leave the model; they face its middle."""
        low, high = self.bounds
        draws = np.random.default_rng(0).uniform(low, high, (_DRAWS, 3))
        found = [(*self._room_at(position), position) for position in draws]
        wide = [one for one in found if one[0] >= _CLEARANCE] or [max(found, key=lambda one: one[0])]
        if wide[0][0] < _LEAST_CLEARANCE:
            raise InputError(
                f"no place with {_LEAST_CLEARANCE} m of clearance was found between {low.round(2).tolist()} and "
                f"{high.round(2).tolist()}: give start=x,y,z,yaw, or larger bounds"
            )
        starts = []
        for clearance, _, position in sorted(wide, key=lambda one: one[1])[:_PLACES]:
            x, y, _ = 0.5 * (low + high) - position
            starts.append(Start(look_along(position, np.array([x, y, 0.0])), min(clearance, _FREE)))
        return starts

    def _room_at(self, position: np.ndarray) -> tuple[float, float]:
        """Return the clearance, 0 inside a convex geom, and the share of rays that hit nothing."""
        kinds = self._mujoco.mjtGeom
        solid = np.isin(
            self.model.geom_type,
            [
                kinds.mjGEOM_SPHERE,
                kinds.mjGEOM_CAPSULE,
                kinds.mjGEOM_ELLIPSOID,
                kinds.mjGEOM_CYLINDER,
                kinds.mjGEOM_BOX,
            ],
        )
        turned = self.data.geom_xmat.reshape(-1, 3, 3)
        local = np.einsum("ni,nij->nj", position - self.data.geom_xpos, turned) - self.model.geom_aabb[:, :3]
        solid &= _drawn(self.model)
        if (solid & (np.abs(local) <= self.model.geom_aabb[:, 3:]).all(axis=1)).any():
            return 0.0, 0.0
        hit = np.zeros(1, np.int32)
        distances = np.array([
            self._mujoco.mj_ray(self.model, self.data, position, ray, _SHOWN_GROUPS, 1, -1, hit)
            for ray in fibonacci_directions(_RAYS)
        ])  # fmt: skip
        met = distances >= 0.0
        return _BETWEEN * float(distances[met].min(initial=np.inf)), float(1.0 - met.mean())


class _Drawing:
    """Hold MuJoCo's scene and renderer in an OpenGL context."""

    def __init__(self, mujoco: Any, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        self._mujoco, self._model = mujoco, model
        self._option, self._free = mujoco.MjvOption(), mujoco.MjvCamera()
        self._option.geomgroup[:] = _SHOWN_GROUPS
        self._option.sitegroup[:] = 0
        self._free.type, self._free.distance = mujoco.mjtCamera.mjCAMERA_FREE, 1.0
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0
        self._rect = mujoco.MjrRect(0, 0, *size)
        osmesa = os.environ.get("MUJOCO_GL", "").lower() == "osmesa"
        self._context = _osmesa_context(mujoco, size) if osmesa else EGLContext()
        self._context.make_current()
        try:
            renderer = self._renderer = _renderer_of(mujoco, model, size)
        finally:
            self._leave()
        self._process = os.getpid()
        self.close = weakref.finalize(self, _free, self._context, renderer, self._process)

    def _leave(self) -> None:
        if isinstance(self._context, EGLContext):
            self._context.release()

    def draw(
        self, data: mujoco.MjData, pose: np.ndarray, camera: PinholeCamera
    ) -> tuple[np.ndarray, np.ndarray]:  # [H, W, 3] uint8, [H, W] float32 metres
        """Return colour and depth in the renderer's size, one sample at each pixel's centre."""
        mujoco, scene = self._mujoco, self._scene
        if not self.close.alive:
            raise ValueError("the world is closed")
        if os.getpid() != self._process:
            raise InputError(
                "the world 'mujoco' cannot draw in a process forked after it was made: make it in the new process, or "
                "start workers with 'spawn' or 'forkserver'"
            )
        right, down, forward, position = pose[:3].T
        # The free camera places the headlight; then every number of the drawn one is set, roll included.
        self._free.lookat = position + forward
        self._free.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
        self._free.elevation = np.degrees(np.arcsin(np.clip(forward[2], -1.0, 1.0)))
        shown = mujoco.mjtCatBit.mjCAT_STATIC.value | mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._free, shown, scene)
        half = _NEAR * 0.5 * camera.height / camera.fy
        for eye in scene.camera:
            eye.pos, eye.forward, eye.up = position, forward, -down
            eye.frustum_near, eye.frustum_center, eye.frustum_bottom, eye.frustum_top = _NEAR, 0.0, -half, half
        far = float(scene.camera[0].frustum_far)
        height, width = self._rect.height, self._rect.width
        rgb, stored = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        self._context.make_current()
        try:
            mujoco.mjr_render(self._rect, scene, self._renderer)
            mujoco.mjr_readPixels(rgb, stored, self._rect, self._renderer)
        finally:
            self._leave()
        # Stored depth is 1 at the near and 0 at the far plane; OpenGL's rows begin at the bottom.
        depth = _NEAR * far / (_NEAR + stored[::-1].astype(np.float64) * (far - _NEAR))
        return rgb[::-1], np.where(stored[::-1] > 0.0, depth, np.inf).astype(np.float32)


def _package() -> Any:
    """Import and return the package mujoco; raise `InputError` without it.

    With ``MUJOCO_GL=egl`` its import fails for the PyOpenGL that pyrender needs; `EGLContext` needs no PyOpenGL.
    """
    wanted = os.environ.get("MUJOCO_GL")
    if wanted is not None and wanted.lower() == "egl":
        del os.environ["MUJOCO_GL"]
    try:
        import mujoco
    except ImportError as error:
        raise InputError(
            f"the world 'mujoco' needs the package mujoco ({error}): pip install 'activestructure-gym[mujoco]'"
        ) from error
    finally:
        if wanted is not None:
            os.environ["MUJOCO_GL"] = wanted
    return mujoco


def _loaded(mujoco: Any, model: Any) -> mujoco.MjModel:
    """Return a model as it is, or read from a file; raise `InputError` for other values and for a file in error."""
    if isinstance(model, mujoco.MjModel):
        return model
    if not isinstance(model, str | os.PathLike):
        raise InputError(f"a MuJoCo model is an MJCF file or a mujoco.MjModel, got {short_repr(model)}")
    if not os.path.isfile(model):
        raise InputError(f"there is no MuJoCo model '{os.fspath(model)}'")
    try:
        return mujoco.MjModel.from_xml_path(os.fspath(model))
    except ValueError as error:
        raise InputError(f"MuJoCo cannot read '{os.fspath(model)}': {error}") from error


def _drawn(model: mujoco.MjModel) -> np.ndarray:  # [geoms] bool
    """Return which geoms are drawn; the group, the colour or the material can make a geom invisible."""
    dressed = model.geom_matid >= 0
    alphas = np.array(model.geom_rgba[:, 3])
    alphas[dressed] = np.minimum(alphas[dressed], model.mat_rgba[model.geom_matid[dressed], 3])
    return (_SHOWN_GROUPS[np.clip(model.geom_group, 0, 5)] > 0) & (alphas > 0)


def _osmesa_context(mujoco: Any, size: tuple[int, int]) -> Any:
    """Return MuJoCo's context of OSMesa; raise `InputError` if it cannot be made."""
    try:
        return mujoco.GLContext(*size)
    except Exception as error:
        # PyOpenGL raises many types of errors.
        raise InputError(
            f"MuJoCo could not start OpenGL with MUJOCO_GL=osmesa ({error}): install Debian's libosmesa6, or unset "
            "MUJOCO_GL to draw through EGL"
        ) from error


def _renderer_of(mujoco: Any, model: mujoco.MjModel, size: tuple[int, int]) -> Any:
    """Return MuJoCo's renderer in the current context, with one sample per pixel; the model is unchanged."""
    screen, quality = model.vis.global_, model.vis.quality
    before = screen.offwidth, screen.offheight, quality.offsamples, quality.shadowsize
    try:
        screen.offwidth, screen.offheight = size
        quality.offsamples, quality.shadowsize = 0, min(quality.shadowsize, _SHADOW_SIZE)
        renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50.value)
    except mujoco.FatalError as error:
        raise InputError(f"MuJoCo cannot draw with the OpenGL of this machine: {error}; {REPAIR}") from error
    finally:
        screen.offwidth, screen.offheight, quality.offsamples, quality.shadowsize = before
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, renderer)
    renderer.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
    return renderer


def _free(context: Any, renderer: Any, process: int) -> None:
    """Free renderer and context, unless this is a fork of the process that made them."""
    if process == os.getpid():
        context.make_current()
        renderer.free()
        context.free()
