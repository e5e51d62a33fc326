"""Sample points on a mesh: a dense regular set that covers it, or a random set uniform by area."""

from __future__ import annotations

import numpy as np

_FACES_AT_ONCE = 1 << 18  # number of faces whose corners are converted to float64 at a time


def lattice_samples(
    vertices: np.ndarray,  # [V, 3] metres
    faces: np.ndarray,  # [F, 3]
    spacing: float,  # metres
) -> np.ndarray:  # [S, 3] float64
    """Return points on the mesh such that every surface point is within ``spacing / sqrt(2)`` of one of them.

    Each face has at least one point. Points are in rows parallel to the longest edge of the triangle, half a spacing
    apart, starting on that edge. From any point of the triangle, the next row is perpendicularly below, however flat
    the triangle. A very thin triangle thus needs one row only.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]  # [F, 3, 3]
    edges = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2)  # [F, 3]: from corner k to k + 1
    longest = edges.argmax(axis=1)
    index = np.arange(len(corners))
    a, b, c = (corners[index, (longest + k) % 3] for k in range(3))
    base = edges[index, longest]
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(base, 1e-12)

    rows = np.maximum(np.ceil(2.0 * height / spacing), 1).astype(np.int64)  # per triangle
    triangle = np.repeat(index, rows)
    t = _ramp(rows) / rows[triangle]  # 0 on the longest edge, towards 1 at the opposite corner
    cells = np.maximum(np.ceil(base[triangle] * (1.0 - t) / spacing), 1).astype(np.int64)  # per row
    row = np.repeat(np.arange(len(triangle)), cells)
    s = (_ramp(cells) + 0.5) / cells[row]
    t, triangle = t[row], triangle[row]
    return a[triangle] + t[:, None] * (c - a)[triangle] + (s * (1.0 - t))[:, None] * (b - a)[triangle]


def samples_per_area(spacing: float) -> float:  # metres -> samples per m^2
    """Return the number of points per m^2 that `lattice_samples` places on triangles much larger than the spacing."""
    return 2.0 / spacing**2


def surface_area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the total area of all triangles, in squared units of the vertices."""
    total = 0.0
    for start in range(0, len(faces), _FACES_AT_ONCE):
        corners = vertices[faces[start : start + _FACES_AT_ONCE]].astype(np.float64)
        total += np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    return 0.5 * float(total)


def _ramp(counts: np.ndarray) -> np.ndarray:
    """Return the numbers 0 to count - 1 for each entry of ``counts``, concatenated."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def uniform_samples(
    vertices: np.ndarray,  # [V, 3] metres
    faces: np.ndarray,  # [F, 3]
    count: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return random points [count, 3] uniform by area, the unit normals of their faces, and the total area in m^2.

    Triangles are drawn by stratified sampling over the cumulated area. The points are spread more evenly than
    independent draws, and each one is uniform.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    edge_b, edge_c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled = np.cross(edge_b, edge_c)
    area = 0.5 * np.linalg.norm(doubled, axis=1)
    points, face, total = samples_by_area(corners, area, count, rng)
    return points, doubled[face] / (2.0 * area[face])[:, None], total


def samples_by_area(
    corners: np.ndarray,  # [F, 3, 3] metres
    area: np.ndarray,  # [F] m^2
    count: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float]:  # [count, 3] metres, [count] index of the triangle, m^2 of all triangles
    """Return random points uniform by area on triangles with given areas, drawn as in `uniform_samples`."""
    cumulated = np.cumsum(area)
    drawn = (np.arange(count) + rng.random(count)) / count * cumulated[-1]
    face = np.minimum(np.searchsorted(cumulated, drawn, side="right"), len(area) - 1)
    return on_triangles(corners[face], rng.random(count), rng.random(count)), face, float(cumulated[-1])


def on_triangles(
    corners: np.ndarray,  # [N, 3, 3] metres
    u: np.ndarray,  # [N] 0..1, modified
    v: np.ndarray,  # [N] 0..1, modified
) -> np.ndarray:  # [N, 3] metres
    """Return one point of each triangle from two random numbers; uniform by area if ``u`` and ``v`` are uniform."""
    outside = u + v > 1.0  # fold the other half of the parallelogram back
    u[outside], v[outside] = 1.0 - u[outside], 1.0 - v[outside]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)
