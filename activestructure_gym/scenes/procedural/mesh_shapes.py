"""Make the closed solids of procedural scenes: box, rounded box, solid of revolution, extrusion, leaf.

Every function returns a `Shape` in local metres with outward normals and faces counter-clockwise from outside. Texture
coordinates are metres along the surface, so that a material's repeats per metre are the same on all shapes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

# Longest edge of a face. Light is baked per vertex, so this limits the resolution of shadows on furniture.
MAX_EDGE = 0.25  # metres


@dataclass(frozen=True)
class Shape:
    """Hold a closed triangle mesh."""

    vertices: np.ndarray  # [V, 3] metres
    normals: np.ndarray  # [V, 3] unit, outward
    faces: np.ndarray  # [F, 3] int
    uv: np.ndarray  # [V, 2] metres along the surface; 0..1 if an image covers a side once


def join(shapes: list[Shape]) -> Shape:
    """Join several shapes into one."""
    offsets = np.cumsum([0] + [len(shape.vertices) for shape in shapes[:-1]])
    return Shape(
        vertices=np.concatenate([shape.vertices for shape in shapes]),
        normals=np.concatenate([shape.normals for shape in shapes]),
        faces=np.concatenate([shape.faces + offset for shape, offset in zip(shapes, offsets)]),
        uv=np.concatenate([shape.uv for shape in shapes]),
    )


@lru_cache(maxsize=1024)
def grid_faces(rows: int, columns: int) -> np.ndarray:  # [2 (rows - 1)(columns - 1), 3]
    """Return two triangles per cell of a grid of rows x columns vertices, stored row by row.

    They are counter-clockwise from outside if the cross product of row and column direction points outward.
    """
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def lines(start: float, end: float, max_edge: float = MAX_EDGE) -> np.ndarray:
    """Return evenly spaced coordinates from start to end, at most ``max_edge`` metres apart."""
    return np.linspace(start, end, max(1, int(np.ceil((end - start) / max_edge - 1e-9))) + 1)


def _cube_sides(axis_lines: list[np.ndarray]) -> list[tuple[int, int, int, np.ndarray]]:
    """Return the six sides of a box as (axis, row axis, column axis, grid of vertices [R, C, 3]), winding outward.

    ``axis_lines`` are the coordinates of the grid lines along x, y and z.
    """
    sides = []
    for axis in range(3):
        for top in (False, True):
            row, column = ((axis + 1) % 3, (axis + 2) % 3) if top else ((axis + 2) % 3, (axis + 1) % 3)
            grid = np.empty((len(axis_lines[row]), len(axis_lines[column]), 3))
            grid[..., row] = axis_lines[row][:, None]
            grid[..., column] = axis_lines[column][None, :]
            grid[..., axis] = axis_lines[axis][-1 if top else 0]
            sides.append((axis, row, column, grid))
    return sides


def _side_uv(grid: np.ndarray, row: int, column: int, *, fit: bool) -> np.ndarray:
    """Return the texture coordinates [R C, 2] of the grid [R, C, 3] of one side, in metres.

    u runs along the longer edge, as wood grain does. With ``fit``, the image covers the side once: u runs along the
    horizontal axis and v down the vertical one, both in 0..1.
    """
    flat = grid.reshape(-1, 3)
    extent = np.ptp(flat, axis=0)
    if fit:
        down, across = (2, row + column - 2) if 2 in (row, column) else (max(row, column), min(row, column))
        u = (flat[:, across] - flat[:, across].min()) / max(extent[across], 1e-9)
        v = (flat[:, down].max() - flat[:, down]) / max(extent[down], 1e-9)
        return np.stack([u, v], axis=1)
    along, across = (row, column) if extent[row] > extent[column] else (column, row)
    return flat[:, [along, across]]


def box(lower: np.ndarray, upper: np.ndarray, *, max_edge: float = MAX_EDGE, fit: bool = False) -> Shape:
    """Return an axis-aligned box with sharp edges; ``fit`` stretches an image once over each side."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if not (upper > lower).all():
        raise ValueError(f"a box needs upper > lower, got {lower} and {upper}")
    parts = []
    centre = (lower + upper) / 2
    for axis, row, column, grid in _cube_sides([lines(lower[k], upper[k], max_edge) for k in range(3)]):
        normal = np.zeros(3)
        normal[axis] = np.sign(grid[0, 0, axis] - centre[axis])
        parts.append(
            Shape(
                vertices=grid.reshape(-1, 3),
                normals=np.tile(normal, (grid.shape[0] * grid.shape[1], 1)),
                faces=grid_faces(*grid.shape[:2]),
                uv=_side_uv(grid, row, column, fit=fit),
            )
        )
    return join(parts)


def rounded_box(
    lower: np.ndarray,
    upper: np.ndarray,
    *,
    radius: float,  # metres, radius of edges and corners
    puff: float = 0.0,  # metres by which the middle of each side bulges out: cushions, pillows
    max_edge: float = MAX_EDGE,
) -> Shape:
    """Return an axis-aligned box with round edges, for cushions, mattresses and ceramics."""
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    half, centre = (upper - lower) / 2, (upper + lower) / 2
    radius = min(radius, 0.999 * float(half.min()))
    inner = half - radius
    # Round corners get two segments, and the flat middle as many as `max_edge` requires.
    axis_lines = [
        np.concatenate([[-h, -h + 0.42 * radius], lines(-i, i, max_edge), [h - 0.42 * radius, h]])
        for h, i in zip(half, inner)
    ]
    parts = []
    for axis, row, column, grid in _cube_sides(axis_lines):
        flat = grid.reshape(-1, 3)
        core = np.clip(flat, -inner, inner)
        normals = flat - core
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        vertices = core + radius * normals
        if puff:
            bulge = np.prod([1 - (flat[:, k] / half[k]) ** 2 for k in (row, column)], axis=0)
            vertices[:, axis] += np.sign(flat[:, axis]) * puff * bulge
        parts.append(
            Shape(vertices + centre, normals, grid_faces(*grid.shape[:2]), _side_uv(grid, row, column, fit=False))
        )
    return join(parts)


def lathe(profile: np.ndarray, *, segments: int = 16) -> Shape:
    """Return the solid of revolution around z of a profile [P, 2] of (radius, height).

    The profile starts and ends on the axis, and runs from the bottom up along the outside. Duplicate points make a
    sharp edge.
    """
    profile = np.asarray(profile, dtype=float)
    if profile[0, 0] != 0 or profile[-1, 0] != 0:
        raise ValueError("the profile of a lathe must start and end on the axis (radius 0)")
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    edge = np.diff(profile, axis=0)
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    length = np.linalg.norm(outward, axis=1, keepdims=True)
    outward = outward / np.maximum(length, 1e-9) * (length > 1e-9)
    normal = np.zeros_like(profile)
    normal[:-1] += outward
    normal[1:] += outward
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    cos, sin = np.cos(angle)[None, :], np.sin(angle)[None, :]
    height = np.broadcast_to(profile[:, 1, None], (len(profile), segments + 1))
    vertices = np.stack([profile[:, :1] * cos, profile[:, :1] * sin, height], axis=-1)
    up = np.broadcast_to(normal[:, 1, None], height.shape)
    normals = np.stack([normal[:, :1] * cos, normal[:, :1] * sin, up], axis=-1)
    travelled = np.concatenate([[0.0], np.cumsum(length[:, 0])])
    girth = profile[:, 0].max() * angle
    uv = np.stack([np.broadcast_to(girth, height.shape), np.broadcast_to(-travelled[:, None], height.shape)], axis=-1)
    faces = grid_faces(len(profile), segments + 1)[:, ::-1]
    return _without_slivers(Shape(vertices.reshape(-1, 3), normals.reshape(-1, 3), faces, uv.reshape(-1, 2)))


def _without_slivers(shape: Shape) -> Shape:
    """Return a shape without triangles of zero area (at poles and sharp edges of a `lathe`) and unused vertices."""
    corner = shape.vertices[shape.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    faces = shape.faces[area > 1e-10]
    used, faces = np.unique(faces, return_inverse=True)
    return Shape(shape.vertices[used], shape.normals[used], faces.reshape(-1, 3), shape.uv[used])


def lying(shape: Shape) -> Shape:
    """Return a shape tipped over, so that its +z axis becomes +y."""
    return replace(shape, vertices=_tip(shape.vertices), normals=_tip(shape.normals))


def _tip(vectors: np.ndarray) -> np.ndarray:
    return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)


def cylinder(radius: float, bottom: float, top: float, *, top_radius: float | None = None, segments: int = 12) -> Shape:
    """Return a closed cylinder or truncated cone on the z axis."""
    upper = radius if top_radius is None else top_radius
    sides = lines(bottom, top)
    profile = [[0, bottom], [radius, bottom]]
    profile += [[radius + (upper - radius) * (z - bottom) / (top - bottom), z] for z in sides]
    return lathe(np.array(profile + [[upper, top], [0, top]]), segments=segments)


def extrusion(outline: np.ndarray, bottom: float, top: float, *, max_edge: float = MAX_EDGE) -> Shape:
    """Return a closed upright wall from height ``bottom`` to ``top`` over a strip in the floor plane.

    ``outline`` [N, 2, 2] are pairs of (front, back) points in x, y along the strip. Curtains use it: front and back
    follow the pleats.
    """
    front, back = outline[:, 0], outline[:, 1]
    levels = lines(bottom, top, max_edge)
    loop = np.concatenate([front, back[::-1], front[:1]])
    edge = np.diff(loop, axis=0)
    length = np.linalg.norm(edge, axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(length)])
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
    normal = outward + np.roll(outward, 1, axis=0)
    normal = np.concatenate([normal, normal[:1]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shape = (len(loop), len(levels))
    vertices = np.empty((*shape, 3))
    vertices[..., :2] = loop[:, None]
    vertices[..., 2] = levels
    normals = np.zeros((*shape, 3))
    normals[..., :2] = normal[:, None]
    uv = np.stack(np.broadcast_arrays(travelled[:, None], -levels[None, :]), axis=-1)
    parts = [Shape(vertices.reshape(-1, 3), normals.reshape(-1, 3), grid_faces(*shape), uv.reshape(-1, 2))]
    for height, up in ((bottom, -1.0), (top, 1.0)):
        strip = np.concatenate([outline.reshape(-1, 2), np.full((2 * len(outline), 1), height)], axis=1)
        faces = grid_faces(len(outline), 2)
        parts.append(
            Shape(strip, np.tile([0, 0, up], (len(strip), 1)), faces[:, ::-1] if up < 0 else faces, strip[:, :2])
        )
    return join(parts)


def leaf(length: float, width: float, thickness: float, droop: float) -> Shape:
    """Return a lens-shaped leaf from the origin along +y, with its tip ``droop`` metres lower."""
    rows, around = 9, 7
    t = np.linspace(0, 1, rows)
    outline = np.sin(np.pi * t**0.7) ** 0.8
    angle = np.linspace(0, 2 * np.pi, around)
    y = np.broadcast_to(length * t[:, None], (rows, around))
    x = width / 2 * outline[:, None] * np.cos(angle)
    z = 0.5 * thickness * outline[:, None] ** 0.5 * np.sin(angle) - droop * t[:, None] ** 2
    vertices = np.stack([x, y, z], axis=-1)
    normals = np.stack([np.cos(angle) * thickness, np.zeros(around), np.sin(angle) * width], axis=-1)
    normals = np.broadcast_to(normals / np.linalg.norm(normals, axis=-1, keepdims=True), vertices.shape)
    faces = grid_faces(rows, around)
    uv = vertices[..., :2].reshape(-1, 2)
    return _without_slivers(Shape(vertices.reshape(-1, 3), normals.reshape(-1, 3), faces, uv))
