"""Draw the plan: the map from above, free and occupied space, and the camera's path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.archive.picture_record import pixel_size, plan_scale
from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.pictures.canvas import MARGIN, text_width, write

_SMOOTH = 3  # supersampling factor: images are drawn this many times larger and then reduced
# Colours of pixels without a mapped surface, by their label in the legend.
FILLS = {
    "not observed": style.UNKNOWN,
    "observed free, without mapped surface": style.FREE,
    "occupied, not mapped": style.OCCUPIED,
}
_LEVEL, _FLOOR_M2 = 0.8, 0.5  # a plane is a floor from this z of its unit normal and this observed area (m^2) on


def draw_plan(
    arrays: Mapping[str, np.ndarray], trajectory: Mapping[str, np.ndarray], widest: float = math.inf
) -> Image.Image:
    """Return the plan of a run, seen from above with y up: map, free and occupied space, path and keyframes.

    ``arrays`` are the run's stored picture arrays, and ``trajectory`` has its poses. The image is at most ``widest``
    pixels wide; line widths do not depend on this.
    """
    extent = arrays["plan_extent"]
    scale = min(plan_scale(extent), widest / float(extent[0])) * _SMOOTH
    picture = plan_base(arrays, scale)
    _draw_path(picture, arrays, trajectory, scale)
    draw_scale_bar(picture, scale)
    return picture.resize((picture.width // _SMOOTH, picture.height // _SMOOTH), Image.Resampling.LANCZOS)


def plan_base(arrays: Mapping[str, np.ndarray], scale: float) -> Image.Image:
    """Return the map from above over free and occupied space, without the path, at ``scale`` pixels per metre."""
    size = pixel_size(arrays["plan_extent"], scale)
    picture = _ground(arrays).resize(size, Image.Resampling.NEAREST)
    above = Image.fromarray(arrays["above_rgb"], "RGB").resize(size, Image.Resampling.BICUBIC)
    opacity = Image.fromarray(arrays["above_alpha"], "L").resize(size, Image.Resampling.BICUBIC)
    picture.paste(above, (0, 0), opacity)
    return picture


def legend() -> Image.Image:
    """Return the legend of `draw_plan` as an image of one row."""
    entries = ("start", "end", "path, first to last frame", "keyframe and view direction", *FILLS)
    widths = [44 + text_width(entry, 13) + 18 for entry in entries]
    strip = Image.new("RGB", (2 * MARGIN + sum(widths), 34), style.PAPER)
    draw, x, y = ImageDraw.Draw(strip), MARGIN, 12
    for entry, width in zip(entries, widths):
        if entry == "start":
            _disc(draw, (x + 16, y), 7, style.START)
        elif entry == "end":
            _square(draw, (x + 16, y), 6, style.END)
        elif entry.startswith("path"):
            for step in range(32):
                draw.line([(x + step, y), (x + step + 1, y)], fill=style.path_colour(step / 31), width=5)
        elif entry.startswith("keyframe"):
            _keyframe(draw, (x + 10, y), (1.0, 0.0), 1)
        else:
            draw.rectangle([x + 6, y - 7, x + 28, y + 7], fill=FILLS[entry], outline=style.FAINT_INK)
        write(strip, (x + 38, y), entry, size=13, anchor="lm")
        x += width
    return strip


def camera_height_text(paths: Sequence[tuple[Mapping[str, np.ndarray], Mapping[str, np.ndarray] | None]]) -> str:
    """Return a sentence with the lowest and highest camera height along trajectories, in metres.

    ``paths`` has a trajectory and a Plane Scene Graph per run. Heights are above the lowest floor of each graph. If a
    graph is missing or has no floor, they are z in the world frame.
    """
    floors = [None if graph is None else _floor(graph) for _, graph in paths]
    known = [floor for floor in floors if floor is not None]
    reference, datum = ("above the floor", known) if len(known) == len(paths) else ("in z", [0.0] * len(paths))
    heights = [path["world_from_camera"][:, 2, 3] - zero for (path, _), zero in zip(paths, datum)]
    low, high = (f"{end:.1f}" for end in (min(h.min() for h in heights), max(h.max() for h in heights)))
    height = f"{low} m" if low == high else f"{low} to {high} m"
    return f"Camera height: {height} {reference}. A path may lead over furniture below this height."


def _floor(graph: Mapping[str, np.ndarray]) -> float | None:
    level = (graph["normals"][:, 2] >= _LEVEL) & (graph["areas"] >= _FLOOR_M2)
    return float(graph["centroids"][level, 2].min()) if level.any() else None


def _ground(arrays: Mapping[str, np.ndarray]) -> Image.Image:
    palette = np.array([style.UNKNOWN, style.FREE, style.OCCUPIED], np.uint8)
    return Image.fromarray(np.ascontiguousarray(palette[arrays["plan_state"]].transpose(1, 0, 2)[::-1]), "RGB")


def _draw_path(
    picture: Image.Image, arrays: Mapping[str, np.ndarray], trajectory: Mapping[str, np.ndarray], scale: float
) -> None:
    draw = ImageDraw.Draw(picture)
    poses = trajectory["world_from_camera"]
    offset = (poses[:, :2, 3] - arrays["plan_corner"]) * scale
    points = [(float(x), float(picture.height - y)) for x, y in offset]
    unit = _SMOOTH
    draw.line(points, fill=style.PAPER, width=6 * unit, joint="curve")
    last = max(1, len(points) - 1)
    for index in range(len(points) - 1):
        segment = [points[index], points[index + 1]]
        draw.line(segment, fill=style.path_colour(index / last), width=3 * unit)
        _disc(draw, points[index + 1], 1.5 * unit, style.path_colour(index / last), edge=False)
    for index in trajectory["keyframes"]:
        forward = poses[index][:2, 2]
        _keyframe(draw, points[index], (float(forward[0]), -float(forward[1])), unit)
    _square(draw, points[-1], 6 * unit, style.END, unit)
    _disc(draw, points[0], 7 * unit, style.START, unit=unit)


def draw_scale_bar(picture: Image.Image, scale: float) -> None:
    """Draw a scale bar of 1 m, or of 5 m for large scenes, into a supersampled image of ``scale`` pixels per metre."""
    metres = 1 if scale / _SMOOTH >= 30 else 5
    length, unit = metres * scale, _SMOOTH
    left, bottom = 12 * unit, picture.height - 12 * unit
    draw = ImageDraw.Draw(picture)
    draw.rectangle([left - 5 * unit, bottom - 22 * unit, left + length + 5 * unit, bottom + 5 * unit], fill=style.PAPER)
    draw.line([(left, bottom), (left + length, bottom)], fill=style.INK, width=3 * unit)
    write(picture, (left + length / 2, bottom - 4 * unit), f"{metres} m", size=13 * unit, anchor="ms")


def _disc(
    draw: ImageDraw.ImageDraw,
    centre: tuple[float, float],
    radius: float,
    fill: tuple[int, int, int],
    unit: int = 1,
    *,
    edge: bool = True,
) -> None:
    x, y = centre
    if edge:
        ring = radius + 2 * unit
        draw.ellipse([x - ring, y - ring, x + ring, y + ring], fill=style.PAPER)
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=fill)


def _square(
    draw: ImageDraw.ImageDraw, centre: tuple[float, float], radius: float, fill: tuple[int, int, int], unit: int = 1
) -> None:
    x, y = centre
    ring = radius + 2 * unit
    draw.rectangle([x - ring, y - ring, x + ring, y + ring], fill=style.PAPER)
    draw.rectangle([x - radius, y - radius, x + radius, y + radius], fill=fill)


def _keyframe(
    draw: ImageDraw.ImageDraw,
    place: tuple[float, float],
    direction: tuple[float, float],  # horizontal part of the unit view direction
    unit: int,
) -> None:
    length = 13 * unit
    draw.line([place, (place[0] + length * direction[0], place[1] + length * direction[1])], fill=style.INK, width=unit)
    _disc(draw, place, 2.5 * unit, style.PAPER, edge=False)
    _disc(draw, place, 1.7 * unit, style.INK, edge=False)
