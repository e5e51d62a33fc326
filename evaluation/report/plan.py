"""The plan: a reconstruction seen from above, what is known around it, and the way the camera went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from activestructure_gym.evaluation.report import style
from activestructure_gym.evaluation.report.canvas import MARGIN, text_width, write

if TYPE_CHECKING:
    from activestructure_gym.reconstruction import Reconstruction

_PIXELS_PER_METRE = 90
_LONGEST_SIDE = 640  # pixels; larger scenes are drawn smaller
_SMOOTH = 3  # everything drawn by line is drawn this much larger and averaged
_BAND_M = 0.5  # free and occupied are those of this height above and below the camera
_HEADROOM_M = 0.35  # Gaussians higher than this above the camera's start (ceiling, lamps) would hide the rest
# What shows where the map has no surface.
FILLS = {
    "not seen": style.UNKNOWN,
    "free, nothing mapped below": style.FREE,
    "occupied, not mapped": style.OCCUPIED,
}
_LEVEL, _FLOOR_M2 = 0.8, 0.5  # a floor's normal has at least this z, and it has been seen on this area
_ALTITUDE = 60.0  # the eye's height above the plan in scene widths: as good as parallel


def plan_arrays(reconstruction: Reconstruction) -> dict[str, np.ndarray]:
    """What `draw_plan` needs: the volume's plan, and the Gaussian map seen from above in the same frame."""
    from activestructure_gym.volume import FREE, OCCUPIED, UNKNOWN

    volume = reconstruction.volume
    voxel = volume.config.voxel_size
    height = float(reconstruction.trajectory[0][2, 3])
    low, high = (int(np.floor((height + side * _BAND_M - volume.origin[2]) / voxel)) for side in (-1, 1))
    band = volume.state[:, :, max(low, 0) : max(high + 1, 1)]
    state = np.full(band.shape[:2], UNKNOWN, np.uint8)
    state[(band == FREE).any(axis=2)] = FREE
    state[(band == OCCUPIED).any(axis=2)] = OCCUPIED
    corner = np.asarray(volume.origin[:2], np.float64)
    extent = np.array(state.shape) * voxel
    colour, alpha = _from_above(reconstruction, corner, extent, height)
    return {
        "plan_state": np.select([state == FREE, state == OCCUPIED], [1, 2], 0).astype(np.uint8),
        "plan_corner": corner,
        "plan_extent": extent,
        "above_rgb": colour,
        "above_alpha": alpha,
    }


def draw_plan(arrays: Mapping[str, np.ndarray], trajectory: Mapping[str, np.ndarray]) -> Image.Image:
    """The picture, y up: map from above, free and occupied space, path from blue to yellow, keyframes, start, end."""
    scale = plan_scale(arrays["plan_extent"]) * _SMOOTH
    picture = plan_base(arrays, scale)
    _draw_path(picture, arrays, trajectory, scale)
    draw_scale_bar(picture, scale)
    return picture.resize((picture.width // _SMOOTH, picture.height // _SMOOTH), Image.Resampling.LANCZOS)


def plan_base(arrays: Mapping[str, np.ndarray], scale: float) -> Image.Image:
    """What was known of the space, and over it the map from above, at ``scale`` pixels per metre."""
    size = pixel_size(arrays["plan_extent"], scale)
    picture = _ground(arrays).resize(size, Image.Resampling.NEAREST)
    above = Image.fromarray(arrays["above_rgb"], "RGB").resize(size, Image.Resampling.BICUBIC)
    opacity = Image.fromarray(arrays["above_alpha"], "L").resize(size, Image.Resampling.BICUBIC)
    picture.paste(above, (0, 0), opacity)
    return picture


def legend() -> Image.Image:
    """The key to `draw_plan`'s signs, as a strip."""
    entries = ("start", "end", "path, first to last frame", "keyframe, looking ahead", *FILLS)
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


def flight(paths: Sequence[tuple[Mapping[str, np.ndarray], Mapping[str, np.ndarray] | None]]) -> str:
    """How high the camera flew, of trajectories with their graphs: above the lowest floor that each has seen.

    Without a floor in every graph the heights are the world's z.
    """
    floors = [None if graph is None else _floor(graph) for _, graph in paths]
    known = [floor for floor in floors if floor is not None]
    ground, datum = ("above the floor", known) if len(known) == len(paths) else ("in z", [0.0] * len(paths))
    heights = [path["world_from_camera"][:, 2, 3] - zero for (path, _), zero in zip(paths, datum)]
    low, high = (f"{end:.1f}" for end in (min(h.min() for h in heights), max(h.max() for h in heights)))
    at = f"at {low} m" if low == high else f"at {low} to {high} m"
    return f"The camera flies {at} {ground}, so a path may cross furniture that is lower."


def _floor(graph: Mapping[str, np.ndarray]) -> float | None:
    level = (graph["normals"][:, 2] >= _LEVEL) & (graph["areas"] >= _FLOOR_M2)
    return float(graph["centroids"][level, 2].min()) if level.any() else None


def _from_above(
    reconstruction: Reconstruction, corner: np.ndarray, extent: np.ndarray, height: float
) -> tuple[np.ndarray, np.ndarray]:  # [h, w, 3] uint8, [h, w] uint8
    from activestructure_gym.geometry import PinholeCamera, look_along
    from activestructure_gym.splatting import cpu

    gaussians = reconstruction.mapper.map
    below = gaussians.parameters[2, : gaussians.count] < height + _HEADROOM_M
    parameters = np.ascontiguousarray(gaussians.parameters[:, : gaussians.count][:, below])
    scale = plan_scale(extent)
    width, rows = pixel_size(extent, scale)
    altitude = _ALTITUDE * float(extent.max())
    focal = altitude * scale
    camera = PinholeCamera(width, rows, focal, focal, width / 2, rows / 2)
    eye = np.array([*(corner + extent / 2), height + altitude])
    seen = cpu.render(parameters, parameters.shape[1], camera, look_along(eye, np.array([0.0, 0.0, -1.0])))
    solid = seen.alpha > 1e-3
    colour = np.where(solid[..., None], seen.color / np.where(solid, seen.alpha, 1.0)[..., None], 0.0)
    return np.rint(255 * np.clip(colour, 0, 1)).astype(np.uint8), np.rint(255 * seen.alpha).astype(np.uint8)


def plan_scale(extent: np.ndarray) -> float:  # pixels per metre
    """How large a plan of this extent [2] metres is drawn."""
    return min(_PIXELS_PER_METRE, _LONGEST_SIDE / float(np.max(extent)))


def pixel_size(extent: np.ndarray, scale: float) -> tuple[int, int]:
    """Width and height of a plan of ``extent`` [2] metres, at least one pixel each."""
    return max(1, round(float(extent[0]) * scale)), max(1, round(float(extent[1]) * scale))


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
    """One metre, or five where one would be too short to see, in a picture drawn three times too large."""
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
    direction: tuple[float, float],  # its length is the share of the view that is horizontal
    unit: int,
) -> None:
    length = 13 * unit
    draw.line([place, (place[0] + length * direction[0], place[1] + length * direction[1])], fill=style.INK, width=unit)
    _disc(draw, place, 2.5 * unit, style.PAPER, edge=False)
    _disc(draw, place, 1.7 * unit, style.INK, edge=False)
