"""Draw a scene on the graphics card with pyrender through EGL.

Import this module only through `pyrender_backend`, which prepares the import of pyrender. Subclasses fix faults of
pyrender 0.1.45, so that other users of pyrender in the process are not affected:

* Its frame buffer has 4 samples per pixel and takes the depth of the first one, which is off the pixel's centre by a
driver-dependent amount. This one has one sample, at the centre.
* Deleting one context closes the connection to the display, and with it every other context. Here it stays open.
* It leaves the context bound to the thread that drew last. Here it is released, so that any thread may draw next.
* It shears textures whose rows are not a multiple of 4 bytes. Here they are uploaded without padding.
"""

from __future__ import annotations

import os
import threading
import types
import weakref
from typing import Any

import numpy as np
import pyrender
import pyrender.mesh
from OpenGL import EGL, GL
from OpenGL.arrays.ctypesparameters import CtypesParameterHandler
from pyrender.constants import GLTF
from pyrender.platforms.egl import EGLPlatform, get_device_by_index
from pyrender.shader_program import ShaderProgramCache

from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.scenes.scene import CLAMP, MIRROR, REPEAT, Scene, SceneMesh

if not hasattr(np, "infty"):
    # pyrender.Mesh.bounds uses the alias np.infty, which numpy 2 removed; define it for that module only.
    pyrender.mesh.np = types.SimpleNamespace(**vars(np), infty=np.inf)

# PyOpenGL 3.1.0, which pyrender requires, finds the references of ctypes by a name that Python 3.12 changed.
CtypesParameterHandler().register(CtypesParameterHandler.HANDLED_TYPES)

# Near clipping plane, metres. With 24-bit depth the depth steps are 3e-5 m at 5 m.
_NEAR = 0.05
_WRAPS = {REPEAT: GLTF.REPEAT, CLAMP: GLTF.CLAMP_TO_EDGE, MIRROR: GLTF.MIRRORED_REPEAT}
# OpenGL cameras look along -z with y up.
_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


class _Platform(EGLPlatform):
    _egl_context: Any

    def make_uncurrent(self) -> None:
        EGL.eglMakeCurrent(self._egl_display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)

    def delete_context(self) -> None:
        if self._egl_context is not None:
            self.make_uncurrent()
            EGL.eglDestroyContext(self._egl_display, self._egl_context)
            self._egl_context = None


class _Renderer(pyrender.Renderer):
    """Render with a frame buffer of one sample per pixel."""

    want_color = True
    _main_fb_dims: Any

    def _configure_main_framebuffer(self) -> None:
        size = (self.viewport_width, self.viewport_height)
        if self._main_fb_dims == size:
            return
        self._delete_main_framebuffer()
        self._main_cb, self._main_db = GL.glGenRenderbuffers(2)
        self._main_fb = self._main_fb_ms = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._main_fb)
        for buffer, storage, attachment in (
            (self._main_cb, GL.GL_RGBA8, GL.GL_COLOR_ATTACHMENT0),
            (self._main_db, GL.GL_DEPTH_COMPONENT24, GL.GL_DEPTH_ATTACHMENT),
        ):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, storage, *size)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
        self._main_fb_dims = size

    def _delete_main_framebuffer(self) -> None:
        if self._main_fb is not None:
            GL.glDeleteFramebuffers(1, [self._main_fb])
            GL.glDeleteRenderbuffers(2, [self._main_cb, self._main_db])
        self._main_fb = self._main_fb_ms = self._main_cb = self._main_db = None
        self._main_fb_dims = (None, None)

    def _read_main_framebuffer(self, scene: Any, flags: int) -> tuple[np.ndarray | None, np.ndarray]:
        width, height = self._main_fb_dims
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        stored = GL.glReadPixels(0, 0, width, height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        stored = np.frombuffer(stored, np.float32).reshape(height, width)[::-1]
        near, far = scene.main_camera_node.camera.znear, scene.main_camera_node.camera.zfar
        # Inverse of the perspective depth mapping, in float64: the stored value has 24 significant bits.
        depth = near * far / (far - stored.astype(np.float64) * (far - near))
        depth = np.where(stored < 1.0, depth, 0.0).astype(np.float32)
        if not self.want_color:
            return None, depth
        rgb = GL.glReadPixels(0, 0, width, height, GL.GL_RGB, GL.GL_UNSIGNED_BYTE)
        return np.frombuffer(rgb, np.uint8).reshape(height, width, 3)[::-1], depth


class _LinearColorPrograms(ShaderProgramCache):
    """Provide pyrender's shaders, changed to convert vertex colours from linear light to sRGB after interpolation."""

    def get_program(
        self, vertex_shader: str, fragment_shader: str, geometry_shader: str | None = None, defines: Any = None
    ) -> Any:
        # pyrender replaces a defined text wherever it occurs in a shader.
        defines = {**(defines or {}), "base_color *= color_multiplier;": _DISPLAYED}
        return super().get_program(vertex_shader, fragment_shader, geometry_shader, defines)


_DISPLAYED = (
    "vec3 light = clamp(color_multiplier.rgb, 0.0, 1.0);"
    "base_color.rgb *= mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light));"
)


def _primitives(mesh: SceneMesh) -> list[pyrender.Primitive]:
    """Return one primitive of pyrender per texture, and one for untextured faces, with the vertices that it uses."""
    primitives = []
    for texture in np.unique(mesh.face_texture):
        used, faces = np.unique(mesh.faces[mesh.face_texture == texture], return_inverse=True)
        material = pyrender.MetallicRoughnessMaterial(baseColorFactor=(1.0, 1.0, 1.0, 1.0))
        uv = None
        if texture >= 0:
            across, down = mesh.texture_wrap[texture] if mesh.texture_wrap else (REPEAT, REPEAT)
            # Bilinear without mip maps, as in the ray caster; pyrender counts v from the bottom row.
            material.baseColorTexture = pyrender.Texture(
                source=mesh.textures[texture],
                source_channels="RGB",
                sampler=pyrender.Sampler(
                    magFilter=GLTF.LINEAR, minFilter=GLTF.LINEAR, wrapS=_WRAPS[across], wrapT=_WRAPS[down]
                ),
            )
            uv = np.stack([mesh.uv[used, 0], 1.0 - mesh.uv[used, 1]], axis=1)
        primitives.append(
            pyrender.Primitive(
                positions=mesh.vertices[used],
                texcoord_0=uv,
                color_0=np.clip(mesh.colors[used], 0.0, None),
                indices=faces.reshape(-1, 3),
                material=material,
            )
        )
    return primitives


def _release(platform: _Platform, renderer: _Renderer, process: int) -> None:
    """Free an OpenGL context, unless this is a fork of the process with the id ``process`` that created it."""
    if process != os.getpid():
        return
    platform.make_current()
    renderer.delete()
    platform.delete_context()


class GLScene:
    """Hold geometry, textures and shaders of one scene in an OpenGL context of its own, and draw images of it."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._lock = threading.Lock()
        self._corners = np.stack(np.meshgrid(*scene.bounds.T, indexing="ij"), axis=-1).reshape(-1, 3)
        self._graph = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0))
        if len(scene.mesh.faces):
            self._graph.add(pyrender.Mesh(_primitives(scene.mesh)))
        self._camera = pyrender.IntrinsicsCamera(1.0, 1.0, 0.5, 0.5, znear=_NEAR, zfar=2.0 * _NEAR)
        self._camera_node = self._graph.add(self._camera)
        platform = _Platform(1, 1, device=get_device_by_index(int(os.environ.get("EGL_DEVICE_ID", "0"))))
        platform.init_context()
        platform.make_current()
        if not GL.glDepthRange:  # PyOpenGL found only part of GL, for example libOpenGL without libGL
            raise RuntimeError("libGL is missing or incomplete")
        # Pixel rows are not padded; otherwise pyrender shears textures of odd width.
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        self._platform, self._renderer = platform, _Renderer(1, 1)
        if scene.mesh.linear_colors:
            self._renderer._program_cache = _LinearColorPrograms()
        platform.make_uncurrent()
        self.close = weakref.finalize(self, _release, platform, self._renderer, os.getpid())

    def draw(
        self, camera: PinholeCamera, world_from_camera: np.ndarray, *, color: bool = True
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Return RGB [H, W, 3] uint8 (None unless ``color``) and depth [H, W] float32 in metres.

        Both take one sample at each pixel's centre.
        """
        with self._lock:
            reach = np.linalg.norm(self._corners - world_from_camera[:3, 3], axis=1).max()
            self._camera.fx, self._camera.fy = camera.fx, camera.fy
            self._camera.cx, self._camera.cy = camera.cx, camera.cy
            self._camera.zfar = float(1.01 * reach + 2.0 * _NEAR)
            self._graph.set_pose(self._camera_node, world_from_camera @ _OPENCV_FROM_OPENGL)
            self._platform.make_current()
            try:
                self._renderer.viewport_width, self._renderer.viewport_height = camera.width, camera.height
                self._renderer.want_color = color
                flags = pyrender.RenderFlags
                return self._renderer.render(self._graph, flags.OFFSCREEN | flags.FLAT | flags.SKIP_CULL_FACES)
            finally:
                self._platform.make_uncurrent()
