"""Draw an overview of a scene: the scene from above without its ceiling, and views from its start poses.

The plan is pale outside the region of free space in which episodes take place.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import (
    GAP,
    MARGIN,
    corner_label,
    paste_framed,
    tile_grid,
    to_image,
    write,
)
from activestructure_gym.evaluation.report.pictures.floor_plan import draw_scale_bar, pixel_size, plan_scale
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.sensors.renderer import make_renderer

if TYPE_CHECKING:
    from activestructure_gym.ground_truth import FreeSpace, GroundTruth
    from activestructure_gym.scenes import Scene

_HEADROOM_M = 0.6  # metres; triangles with a centre higher than this above the start poses (the ceiling) are left out
_ALTITUDE = 60.0  # height of the camera above the scene in scene widths, so its rays are almost parallel
_VIEW = (320, 180)  # width and height of a view in pixels
_SMOOTH = 3  # supersampling factor: symbols are drawn this many times larger and then reduced
_PALE = 0.65  # share of white that is blended into the plan outside the region in use


def scene_picture(known: GroundTruth) -> Image.Image:
    """Return an image of the scene ``known``: its plan with the start poses, and up to four views from start poses."""
    scene, space = known.scene, known.free_space
    poses = space.start_poses
    chosen = [int(index) for index in np.unique(np.linspace(0, len(poses) - 1, 4).round())] if len(poses) else []
    renderer = make_renderer("auto", scene)
    camera = PinholeCamera.from_size(*_VIEW)
    try:
        views = [to_image(renderer.render(camera, poses[index], supersample=4)[0]) for index in chosen]
    finally:
        renderer.close()
    extent = scene.bounds[1] - scene.bounds[0]
    title = f"{scene.name}: {' x '.join(f'{side:.1f}' for side in extent)} m, {len(scene.mesh.faces):,} triangles"
    plan = _plan(scene, space, chosen)
    if not views:
        return tile_grid([[plan]], title=title)
    for number, view in enumerate(views, start=1):
        corner_label(view, str(number), size=14, at_top=True)
    # The views have one column next to a tall plan, and two columns next to a wide one.
    columns = 1 if plan.height > 2.5 * _VIEW[1] else 2
    rows = -(-len(views) // columns)
    left = plan.width + MARGIN
    size = left + columns * (_VIEW[0] + GAP) - GAP, max(plan.height, rows * (_VIEW[1] + GAP) - GAP)
    both = Image.new("RGB", (size[0] + 2, size[1] + 2), style.PAPER)
    both.paste(plan, (1, 1))
    for number, view in enumerate(views):
        row, column = divmod(number, columns)
        paste_framed(both, view, (1 + left + column * (_VIEW[0] + GAP), 1 + row * (_VIEW[1] + GAP)))
    return tile_grid([[both]], title=title, frames=False)


def _plan(scene: Scene, space: FreeSpace, numbered: list[int]) -> Image.Image:
    (low, high), poses = scene.bounds, space.start_poses
    eye_height = float(np.median(poses[:, 2, 3])) if len(poses) else float(low[2] + 1.3)
    middle = scene.mesh.vertices[scene.mesh.faces, 2].mean(axis=1)
    keep = middle < eye_height + _HEADROOM_M
    opened = replace(
        scene, mesh=replace(scene.mesh, faces=scene.mesh.faces[keep], face_texture=scene.mesh.face_texture[keep])
    )
    extent = (high - low)[:2]
    scale = plan_scale(extent)
    size = pixel_size(extent, scale)
    altitude = _ALTITUDE * float(extent.max())
    camera = PinholeCamera(*size, altitude * scale, altitude * scale, size[0] / 2, size[1] / 2)
    eye = np.array([*(low[:2] + extent / 2), high[2] + altitude])
    renderer = make_renderer("auto", opened)
    try:
        colour, depth = renderer.render(camera, look_along(eye, np.array([0.0, 0.0, -1.0])), supersample=4)
    finally:
        renderer.close()
    paper = np.array(style.PAPER)
    colour = np.where(depth[..., None] > 0, colour, paper)
    used = _is_used(space, low, (high[1] - low[1]), scale, colour.shape[:2])
    colour = np.where(used[..., None], colour, _PALE * paper + (1 - _PALE) * colour).astype(np.uint8)
    picture = to_image(colour).resize((size[0] * _SMOOTH, size[1] * _SMOOTH), Image.Resampling.LANCZOS)
    draw, fine = ImageDraw.Draw(picture), scale * _SMOOTH
    for index, pose in enumerate(poses):
        x, y = (pose[:2, 3] - low[:2]) * fine
        place = (float(x), float(picture.height - y))
        radius, ahead = 7 * _SMOOTH, 18 * _SMOOTH
        end = place[0] + ahead * float(pose[0, 2]), place[1] - ahead * float(pose[1, 2])
        draw.line([place, end], fill=style.PAPER, width=5 * _SMOOTH)
        draw.line([place, end], fill=style.START, width=3 * _SMOOTH)
        corners = [place[0] - radius, place[1] - radius, place[0] + radius, place[1] + radius]
        draw.ellipse(corners, fill=style.START, outline=style.PAPER, width=2 * _SMOOTH)
        if index in numbered:
            label = str(numbered.index(index) + 1)
            write(picture, place, label, size=11 * _SMOOTH, bold=True, fill=style.PAPER, anchor="mm")
    draw_scale_bar(picture, fine)
    return picture.resize(size, Image.Resampling.LANCZOS)


def _is_used(
    space: FreeSpace, low: np.ndarray, depth: float, scale: float, shape: tuple[int, ...]
) -> np.ndarray:  # [H, W] bool
    """Return the pixels of the plan that are within 20 cm of the region in use, so its walls are included.

    ``low`` is the lower corner of the scene in metres, ``depth`` its extent along y in metres, ``scale`` the number of
    pixels per metre, and ``shape`` (H, W) the size of the plan.
    """
    from scipy.ndimage import binary_dilation

    columns = binary_dilation(space.clearance.max(axis=2) > 0, iterations=max(1, round(0.2 / space.voxel_size)))
    rows, across = np.arange(shape[0]), np.arange(shape[1])
    x = low[0] + (across + 0.5) / scale
    y = low[1] + depth - (rows + 0.5) / scale
    i, j = (
        np.clip(((values - space.origin[axis]) / space.voxel_size).astype(int), 0, columns.shape[axis] - 1)
        for axis, values in enumerate((x, y))
    )
    return columns[i[None, :], j[:, None]]
