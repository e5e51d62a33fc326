"""Measure the frames per second of the RGB-D sensor when each renderer renders the same views."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.scenes.scene import Scene
from activestructure_gym.sensors.renderer import Renderer, make_renderer, renderer_status

SIZES = ((160, 90), (320, 180), (640, 360))  # (width, height) in pixels


def benchmark_views(scene: Scene, count: int, rng: np.random.Generator) -> np.ndarray:  # [count, 4, 4]
    """Draw ``count`` camera poses (world_from_camera) in the free space of a scene with the generator ``rng``.

    Positions are at least 0.3 m from surfaces; the heading is uniform, the pitch uniform from 30 deg down to 15 deg up.
    """
    positions = ground_truth_of(scene).free_space.sample_positions(count, rng, min_clearance=0.3)
    heading, pitch = rng.uniform(-np.pi, np.pi, count), np.radians(rng.uniform(-30.0, 15.0, count))
    directions = np.stack([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)], axis=1)
    return np.stack([look_along(position, direction) for position, direction in zip(positions, directions)])


def time_renderers(
    renderers: Sequence[Renderer],
    camera: PinholeCamera,
    views: np.ndarray,  # [V, 4, 4] world_from_camera
    *,
    repeats: int,
    supersample: int,  # samples per pixel along each image axis
) -> np.ndarray:  # [R, repeats * V] seconds per frame
    """Return the time of every frame when each of R renderers renders each view ``repeats`` times.

    The renderers alternate, so the load of the machine affects all of them alike. A first round is not timed, since it
    includes compilation and uploads.
    """
    seconds = np.empty((len(renderers), repeats + 1, len(views)))
    for repeat in range(repeats + 1):
        for view, pose in enumerate(views):
            order = range(len(renderers)) if repeat % 2 else reversed(range(len(renderers)))
            for index in order:
                start = time.perf_counter()
                renderers[index].render(camera, pose, supersample=supersample)
                seconds[index, repeat, view] = time.perf_counter() - start
    return seconds[:, 1:].reshape(len(renderers), -1)


def run_sensor_benchmark(
    scenes: Sequence[str | Scene],
    *,
    sizes: Sequence[tuple[int, int]] = SIZES,  # (width, height) in pixels
    repeats: int = 5,  # timed frames per view
    views: int = 10,  # number of random views
    supersample: int = 2,  # samples per pixel along each image axis
    seed: int = 0,
) -> list[dict[str, Any]]:
    """Return one row per scene and image size: median, 10th and 90th percentile of the frames per second.

    ``auto_fps``, ``raycast_fps`` and ``pyrender_fps`` are the medians. ``ratio`` is pyrender's time per frame divided
    by that of the default renderer ``auto``, as the median over frames; above 1, the default is faster. If pyrender
    cannot run, its numbers are None and ``note`` gives the reason. ``scenes`` are scenes or their names for
    `load_scene`; an unknown name raises `InputError`.
    """
    from activestructure_gym.scenes.library import load_scene

    if repeats < 1 or views < 1:
        raise InputError(f"repeats and views must be at least 1, got {repeats} and {views}")
    status = renderer_status()["pyrender"]
    names = ("auto", "raycast", "pyrender")
    used = names if status == "works" else names[:2]
    rows = []
    for spec in scenes:
        scene = load_scene(spec)
        poses = benchmark_views(scene, views, np.random.default_rng(seed))
        renderers = [make_renderer(name, scene) for name in used]
        try:
            for width, height in sizes:
                camera = PinholeCamera.from_size(width, height)
                seconds = time_renderers(renderers, camera, poses, repeats=repeats, supersample=supersample)
                row: dict[str, Any] = {
                    "scene": scene.name,
                    "triangles": len(scene.mesh.faces),
                    "size": f"{width}x{height}",
                    "supersample": supersample,
                    "frames": repeats * len(poses),
                }
                for index, name in enumerate(names):
                    rates = 1.0 / seconds[index] if name in used else None
                    row[f"{name}_fps"] = None if rates is None else float(np.median(rates))
                    row[f"{name}_p10_p90"] = None if rates is None else tuple(np.percentile(rates, (10, 90)).tolist())
                row["ratio"] = float(np.median(seconds[2] / seconds[0])) if used == names else None
                if status != "works":
                    row["note"] = status
                rows.append(row)
        finally:
            for renderer in renderers:
                renderer.close()
    return rows
