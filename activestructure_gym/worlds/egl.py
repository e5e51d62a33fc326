"""Create an OpenGL context without a window, from the system library EGL alone.

MuJoCo needs the compatibility profile, which pyrender's context does not have. MuJoCo's own EGL context needs a newer
PyOpenGL than pyrender allows.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator

from activestructure_gym.errors import InputError

REPAIR = (
    "on Debian 'apt-get install -y --no-install-recommends libegl1 libgl1' installs EGL; "
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
    """Hold an OpenGL context of the device with the number ``EGL_DEVICE_ID``, by default the first one that works.

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
        for device in self._devices():
            self._display = device
            self._context = self._context_on(device)
            if self._context:
                return
        raise InputError(f"EGL could not create an OpenGL context on this machine; {REPAIR}")

    def _devices(self) -> Iterator[ctypes.c_void_p]:
        """Yield the displays of devices, which need no window system."""
        query = self._extension("eglQueryDevicesEXT", ctypes.c_uint)
        display_of = self._extension("eglGetPlatformDisplayEXT", ctypes.c_void_p)
        if query is None or display_of is None:
            return
        devices, count = (ctypes.c_void_p * 64)(), ctypes.c_int()
        query(64, devices, ctypes.byref(count))
        chosen = os.environ.get("EGL_DEVICE_ID")
        for number in range(count.value):
            if chosen is None or chosen == str(number):
                yield ctypes.c_void_p(display_of(_PLATFORM_DEVICE, ctypes.c_void_p(devices[number]), None))

    def _context_on(self, display: ctypes.c_void_p) -> int | None:
        """Return a new context, or None if the device cannot be used."""
        config, found = ctypes.c_void_p(), ctypes.c_int()
        pairs = [value for pair in _ATTRIBUTES.items() for value in pair]
        wanted = (ctypes.c_int * (len(pairs) + 1))(*pairs, _NONE)
        if not display or not self._egl.eglInitialize(display, None, None):
            return None
        self._egl.eglChooseConfig(display, wanted, ctypes.byref(config), 1, ctypes.byref(found))
        if not found.value or not self._egl.eglBindAPI(_OPENGL_API):
            return None
        context: int | None = self._egl.eglCreateContext(display, config, None, None)
        return context

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
