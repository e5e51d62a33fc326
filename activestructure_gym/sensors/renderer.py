"""Define the renderer protocol and select a renderer by name."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.registry import Registry
from activestructure_gym.scenes.scene import Scene

LARGE = 1 << 12  # pixels; smaller images gain nothing


class Renderer(Protocol):
    """Draw colour and depth images of one scene, without noise and without a range limit.

    Implementations can be pickled; heavy parts are rebuilt in the receiving process.
    """

    name: str

    def render(
        self, camera: PinholeCamera, world_from_camera: np.ndarray, *, supersample: int = 2
    ) -> tuple[np.ndarray, np.ndarray]:
        """Render one view from ``world_from_camera`` [4, 4].

        Returns ``rgb`` [H, W, 3] uint8 and ``depth`` [H, W] float32. A pixel's colour is the mean of supersample x
        supersample samples, black where there is no surface. Depth is in metres along the optical axis at the pixel
        centre, never averaged, 0 where there is no surface.
        """
        ...

    def close(self) -> None:
        """Release resources outside Python's memory; may be called twice."""
        ...


RENDERERS: Registry[Callable[[Scene], Renderer]] = Registry(
    "sensor backend", "renderers", fits=callable, wanted="a function of a Scene that returns a Renderer"
)


def make_renderer(name: str, scene: Scene) -> Renderer:
    """Return the renderer called ``name``.

    ``auto`` is ray casting. It draws images of at least `LARGE` pixels triangle by triangle instead, with equal hits up
    to rounding.

    Raises `InputError` for an unknown name, or a missing package (with what to install).
    """
    return RENDERERS.get(name)(scene)


def drawn_images(
    scene: Scene,
    camera: PinholeCamera,
    poses: np.ndarray,  # [N, 4, 4] world_from_camera
    *,
    supersample: int,
    max_range: float = np.inf,  # metres
) -> Iterator[tuple[np.ndarray, np.ndarray]]:  # rgb [H, W, 3] uint8, depth [H, W] float32 metres
    """Yield the colour and depth image of each pose by ``auto``, without noise; depth beyond ``max_range`` is 0."""
    renderer = make_renderer("auto", scene)
    try:
        for pose in poses:
            rgb, depth = renderer.render(camera, pose, supersample=supersample)
            yield rgb, np.where(depth <= np.float32(max_range), depth, np.float32(0.0))
    finally:
        renderer.close()


@RENDERERS.register("pyrender")
def _by_pyrender(scene: Scene) -> Renderer:
    from activestructure_gym.sensors.pyrender_backend import PyrenderRenderer

    return PyrenderRenderer(scene)


@RENDERERS.register("auto")
def _by_size(scene: Scene) -> Renderer:
    from activestructure_gym.sensors.raycast import RaycastRenderer

    return RaycastRenderer(scene, draws_from=LARGE)


@RENDERERS.register("raycast")
def _by_raycast(scene: Scene) -> Renderer:
    from activestructure_gym.sensors.raycast import RaycastRenderer

    return RaycastRenderer(scene)


@RENDERERS.register("warp")
def _by_warp(scene: Scene) -> Renderer:
    try:
        from activestructure_gym.sensors.warp_backend import WarpRenderer
    except ModuleNotFoundError as error:
        if error.name != "warp":
            raise
        raise InputError(f"the sensor backend 'warp' cannot run here: {_WARP_MISSING}") from None
    return WarpRenderer(scene)


_WARP_MISSING = "package warp-lang is missing: pip install 'activestructure-gym[warp]'"


def renderer_status() -> dict[str, str]:
    """Return for each renderer "works", or the reason why it does not.

    OpenGL is tried in a separate process, since a process that has used it must not fork.
    """
    status = {
        "raycast": "works",
        "warp": _WARP_MISSING if importlib.util.find_spec("warp") is None else "works",
    }
    command = "from activestructure_gym.sensors.pyrender_backend import probe; print(probe())"
    path = os.pathsep.join(path for path in sys.path if path)
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8:backslashreplace"}
    try:
        probe = subprocess.run(
            [sys.executable, "-P", "-c", command], env=environment, capture_output=True, encoding="utf-8", timeout=60
        )
        answer = probe.stdout.strip().splitlines()
        status["pyrender"] = answer[-1] if answer else f"starting OpenGL ended the process (code {probe.returncode})"
    except subprocess.TimeoutExpired:
        status["pyrender"] = "starting OpenGL took more than 60 s"
    return status
