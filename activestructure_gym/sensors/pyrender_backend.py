"""Render with OpenGL through pyrender, the alternative to ray casting.

The module is imported only on request and needs the system libraries EGL and GL.
"""

from __future__ import annotations

import os
import sys
import types
import weakref
from typing import TYPE_CHECKING, Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.scenes.scene import Scene, SceneMesh

if TYPE_CHECKING:
    from activestructure_gym.sensors.gl_scene import GLScene

_REPAIR = (
    "on Debian 'apt-get install -y --no-install-recommends libegl1 libgl1' brings them; "
    "the sensor backend 'raycast' needs no system library"
)

# One context per scene object and process, shared by all renderers of that scene.
_contexts: weakref.WeakValueDictionary[int, GLScene] = weakref.WeakValueDictionary()
# The process that first used OpenGL: any OpenGL call in its forked children hangs.
_gl_process: int | None = None


def _import_gl_scene() -> Any:
    """Import and return the module `gl_scene`; raise `InputError` that names a missing package or library."""
    platform = os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    if platform != "egl":
        raise InputError(
            f"the sensor backend 'pyrender' draws through EGL, but PYOPENGL_PLATFORM is '{platform}'; "
            "set it to 'egl' or leave it unset"
        )
    first_time = "pyrender" not in sys.modules
    if first_time:
        # pyrender's viewer needs pyglet and X libraries; it is never opened, so a stub replaces it.
        viewer = types.ModuleType("pyrender.viewer")
        viewer.Viewer = type("Viewer", (), {})  # type: ignore[attr-defined]
        sys.modules["pyrender.viewer"] = viewer
    try:
        from activestructure_gym.sensors import gl_scene
    except Exception as error:
        # PyOpenGL raises many types of errors.
        if isinstance(error, ModuleNotFoundError) and error.name in ("pyrender", "OpenGL"):
            raise InputError("the sensor backend 'pyrender' needs the package: pip install pyrender") from error
        reason = next((part for part in error.args if isinstance(part, str)), type(error).__name__)
        raise InputError(
            f"the sensor backend 'pyrender' needs the system libraries EGL and GL ({reason}); {_REPAIR}"
        ) from error
    finally:
        if first_time:
            sys.modules.pop("pyrender.viewer", None)
    return gl_scene


def _context_of(scene: Scene) -> GLScene:
    global _gl_process
    if _gl_process is not None and _gl_process != os.getpid():
        raise InputError(
            "the sensor backend 'pyrender' cannot draw in a process forked after OpenGL was used; "
            "start workers with 'spawn' or 'forkserver', or use the sensor backend 'raycast'"
        )
    context = _contexts.get(id(scene))
    if context is None:
        module = _import_gl_scene()
        _gl_process = os.getpid()
        try:
            context = module.GLScene(scene)
        except Exception as error:
            # EGL is installed but cannot start: no driver, no device, or no permission.
            raise InputError(
                f"the sensor backend 'pyrender' could not start OpenGL from the system libraries EGL and GL "
                f"({type(error).__name__}: {error}); {_REPAIR}"
            ) from error
        _contexts[id(scene)] = context
    return context


class PyrenderRenderer:
    """Rasterise with OpenGL; images agree with ray casting except at silhouettes.

    Colour is drawn at ``supersample`` times the size and averaged. Depth is never averaged. An odd number of samples
    has one at the pixel's centre; for an even number the depth is drawn again at the image's own size. Surfaces nearer
    than 0.05 m are not drawn. The context is created with the first image, in the process that draws it.
    """

    name = "pyrender"

    def __init__(self, scene: Scene) -> None:
        _import_gl_scene()  # reports missing libraries here instead of with the first image
        self._scene = scene
        self._context: GLScene | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {"_scene": self._scene, "_context": None}

    def render(
        self, camera: PinholeCamera, world_from_camera: np.ndarray, *, supersample: int = 2
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render one view; see `Renderer.render`."""
        import cv2

        if supersample < 1:
            raise ValueError(f"supersample must be at least 1, got {supersample}")
        if self._context is None or _gl_process != os.getpid():
            self._context = _context_of(self._scene)
        pose = np.asarray(world_from_camera, np.float64)
        fine = camera.resized(camera.width * supersample, camera.height * supersample)
        rgb, depth = self._context.draw(fine, pose)
        assert rgb is not None
        if supersample == 1:
            return np.ascontiguousarray(rgb), depth
        if supersample % 2:
            depth = np.ascontiguousarray(depth[supersample // 2 :: supersample, supersample // 2 :: supersample])
        else:
            depth = self._context.draw(camera, pose, color=False)[1]
        size = (camera.width, camera.height)
        return cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA), depth

    def close(self) -> None:
        """Release the OpenGL context, which is freed when the last renderer of the scene has released it."""
        self._context = None


def probe() -> str:
    """Return "works" if a small test image is drawn correctly in this process, otherwise the reason."""
    corners = np.array([[-9, -9, 1], [9, -9, 1], [0, 9, 1]], np.float32)
    mesh = SceneMesh(
        vertices=corners,
        faces=np.array([[0, 1, 2]], np.int32),
        colors=np.ones((3, 3), np.float32),
        uv=np.zeros((3, 2), np.float32),
        face_texture=np.array([-1], np.int32),
    )
    try:
        renderer = PyrenderRenderer(Scene("probe", mesh, "probe"))
        rgb, depth = renderer.render(PinholeCamera.from_size(8, 8), np.eye(4))
    except InputError as error:
        return str(error)
    except Exception as error:
        return f"drawing failed ({type(error).__name__}: {error})"
    if not (np.allclose(depth, 1.0, atol=1e-4) and (rgb == 255).all()):
        return "OpenGL starts but draws wrong pictures"
    return "works"
