"""Points on a mesh: a dense regular set that misses nothing, and a random one that is uniform by area."""

from __future__ import annotations

import numpy as np

_FACES_AT_ONCE = 1 << 18  # whose corners are held in float64 at once


def lattice_samples(
    vertices: np.ndarray,  # [V, 3] metres
    faces: np.ndarray,  # [F, 3]
    spacing: float,  # metres
) -> np.ndarray:  # [S, 3] float64
    """Samples such that every point of the surface is within ``spacing / sqrt(2)`` of one; at least one per face.

    They stand in rows parallel to each triangle's longest edge, half a spacing apart, the first on that edge. Seen
    from any point of the triangle the next row lies straight below, however flat the triangle is; so a needle costs
    one row and not a square of samples.
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
    t = _ramp(rows) / rows[triangle]  # 0 on the longest edge, towards 1 at the corner opposite
    cells = np.maximum(np.ceil(base[triangle] * (1.0 - t) / spacing), 1).astype(np.int64)  # per row
    row = np.repeat(np.arange(len(triangle)), cells)
    s = (_ramp(cells) + 0.5) / cells[row]
    t, triangle = t[row], triangle[row]
    return a[triangle] + t[:, None] * (c - a)[triangle] + (s * (1.0 - t))[:, None] * (b - a)[triangle]


def samples_per_area(spacing: float) -> float:  # metres -> samples per m^2
    """Samples per square metre that `lattice_samples` takes on triangles large against the spacing."""
    return 2.0 / spacing**2


def surface_area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Area of all triangles together, in the square of the vertices' unit."""
    total = 0.0
    for start in range(0, len(faces), _FACES_AT_ONCE):
        corners = vertices[faces[start : start + _FACES_AT_ONCE]].astype(np.float64)
        total += np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    return 0.5 * float(total)


def _ramp(counts: np.ndarray) -> np.ndarray:
    """0 .. count - 1 for every count, one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def uniform_samples(
    vertices: np.ndarray,  # [V, 3] metres
    faces: np.ndarray,  # [F, 3]
    count: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Random points uniform by area [count, 3], the unit normals of their faces [count, 3], and the total area in m^2.

    The triangle is drawn by stratified sampling over the cumulated area, which spreads the points more evenly than
    independent draws and leaves every point uniform.
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
    """The points of `uniform_samples` on triangles whose areas are known."""
    cumulated = np.cumsum(area)
    drawn = (np.arange(count) + rng.random(count)) / count * cumulated[-1]
    face = np.minimum(np.searchsorted(cumulated, drawn, side="right"), len(area) - 1)
    return on_triangles(corners[face], rng.random(count), rng.random(count)), face, float(cumulated[-1])


def on_triangles(
    corners: np.ndarray,  # [N, 3, 3] metres
    u: np.ndarray,  # [N] 0..1, changed
    v: np.ndarray,  # [N] 0..1, changed
) -> np.ndarray:  # [N, 3] metres
    """Return a point of each triangle, uniform by area where ``u`` and ``v`` are."""
    outside = u + v > 1.0  # the other half of the parallelogram, folded back
    u[outside], v[outside] = 1.0 - u[outside], 1.0 - v[outside]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)
