"""Create an OpenGL context without a window, from the system library EGL alone.

MuJoCo needs the compatibility profile, which pyrender's context does not have. MuJoCo's own EGL context needs a newer
PyOpenGL than pyrender allows.
"""

from __future__ import annotations

import ctypes
import os

from activestructure_gym.errors import InputError

REPAIR = (
    "on Debian 'apt-get install -y --no-install-recommends libegl1 libgl1' brings EGL; "
    "with 'libosmesa6' and MUJOCO_GL=osmesa MuJoCo draws without it"
)
# Values of the headers EGL/egl.h and EGL/eglext.h.
_PLATFORM_DEVICE = 0x313F
_OPENGL_API = 0x30A2
_ATTRIBUTES = {
    0x3033: 0x0001,  # surface type: pixel buffer
    0x3040: 0x0008,  # renderable type: OpenGL
    0x3024: 8,  # bits of red, green, blue and depth
    0x3023: 8,
    0x3022: 8,
    0x3025: 24,
}
_NONE = 0x3038


class EGLContext:
    """Hold an OpenGL context of the device with the number ``EGL_DEVICE_ID``, by default the first one.

    Raises
    ------
    InputError
        If the library is missing or no context can be created.
    """

    def __init__(self) -> None:
        try:
            self._egl = ctypes.CDLL("libEGL.so.1")
        except OSError as error:
            raise InputError(f"MuJoCo draws through the system library EGL, which is missing; {REPAIR}") from error
        for name in ("eglGetProcAddress", "eglCreateContext"):
            getattr(self._egl, name).restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._first_display())
        config, found = ctypes.c_void_p(), ctypes.c_int()
        pairs = [value for pair in _ATTRIBUTES.items() for value in pair]
        wanted = (ctypes.c_int * (len(pairs) + 1))(*pairs, _NONE)
        self._context = None
        if self._egl.eglInitialize(self._display, None, None):
            self._egl.eglChooseConfig(self._display, wanted, ctypes.byref(config), 1, ctypes.byref(found))
        if found.value and self._egl.eglBindAPI(_OPENGL_API):
            self._context = self._egl.eglCreateContext(self._display, config, None, None)
        if not self._context:
            raise InputError(f"EGL could not create an OpenGL context on this machine; {REPAIR}")

    def _first_display(self) -> int | None:
        """Return the display of the chosen device: it needs no window system."""
        query = self._extension("eglQueryDevicesEXT", ctypes.c_uint)
        of_platform = self._extension("eglGetPlatformDisplayEXT", ctypes.c_void_p)
        if query is None or of_platform is None:
            return None
        devices, count = (ctypes.c_void_p * 64)(), ctypes.c_int()
        query(64, devices, ctypes.byref(count))
        number = int(os.environ.get("EGL_DEVICE_ID", "0"))
        if not 0 <= number < count.value:
            return None
        display: int | None = of_platform(_PLATFORM_DEVICE, ctypes.c_void_p(devices[number]), None)
        return display

    def _extension(self, name: str, returns: type) -> ctypes._FuncPointer | None:
        address = self._egl.eglGetProcAddress(name.encode())
        return ctypes.CFUNCTYPE(returns)(address) if address else None

    def make_current(self) -> None:
        """Bind the context to this thread."""
        self._bind(self._context)

    def release(self) -> None:
        """Unbind the context, so that any thread may bind it."""
        self._bind(None)

    def _bind(self, context: int | None) -> None:
        self._egl.eglBindAPI(_OPENGL_API)  # a setting of the thread
        if not self._egl.eglMakeCurrent(self._display, None, None, ctypes.c_void_p(context)):
            raise RuntimeError("EGL could not bind an OpenGL context")

    def free(self) -> None:
        """Destroy the context; the connection to the device stays open for other contexts of the process."""
        if self._context:
            self._egl.eglDestroyContext(self._display, ctypes.c_void_p(self._context))
            self._context = None
