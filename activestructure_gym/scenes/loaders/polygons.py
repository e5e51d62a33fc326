"""Convert polygons to triangles: fans for convex ones, ear clipping for concave ones.

A fan over a concave polygon also covers area outside it: a wall would lose its doorway.
"""

from __future__ import annotations

import numpy as np

from activestructure_gym.scenes.loaders.damage import UnreadableMesh

# Sine of the minimum angle by which a concave corner turns back. Float32 errors of a small face far from the origin are
# smaller.
_TURN = 1e-4
_MAX_CORNERS = 10_000  # maximum corners of a concave polygon; its ear clipping takes a third of a second


def triangulated(points: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles [F, 3] over the corners of polygons, and the polygon index [F] of each, in order.

    Parameters
    ----------
    points
        [C, 3] corners of all polygons, concatenated, each in order around its polygon.
    sizes
        [P] number of corners of each polygon; fewer than 3 give no triangle.
    """
    fans = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), fans)
    starts = np.cumsum(sizes) - sizes
    first = starts[polygon]
    k = np.arange(len(polygon)) - np.repeat(np.cumsum(fans) - fans, fans)
    triangles = np.stack([first, first + k + 1, first + k + 2], axis=1)
    ears = triangulated_if_concave(points, sizes)
    if not ears:
        return triangles, polygon
    kept = ~np.isin(polygon, list(ears))
    triangles = np.concatenate([triangles[kept], *(starts[index] + clipped for index, clipped in ears.items())])
    polygon = np.concatenate([polygon[kept], *(np.full(len(clipped), index) for index, clipped in ears.items())])
    order = np.argsort(polygon, kind="stable")
    return triangles[order], polygon[order]


def triangulated_if_concave(points: np.ndarray, sizes: np.ndarray) -> dict[int, np.ndarray]:
    """Return the triangles of each concave polygon by its index, for the arguments of `triangulated`.

    The triangles [F, 3] are indices of the polygon's own corners.
    """
    starts = np.cumsum(sizes) - sizes
    polygon, corner = concave_corners(points, sizes)
    # Scans have many slightly concave quads, which are split at the corner that turns back.
    quads = sizes[polygon] == 4
    ears = {index: _QUAD[place % 2] for index, place in zip(polygon[quads].tolist(), corner[quads].tolist())}
    for index in np.unique(polygon[~quads]).tolist():
        ears[index] = ear_clipped(points[starts[index] : starts[index] + sizes[index]])
    return ears


_QUAD = np.array([[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]])  # through corners 0 and 2, through 1 and 3


def concave_corners(points: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return polygon index and corner index (in its polygon) of all concave corners, as in `triangulated`."""
    if not (sizes > 3).any():
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    polygon = np.repeat(np.arange(len(sizes)), sizes)
    wide = (sizes > 3)[polygon]  # triangles cannot be concave, and most meshes have only triangles
    corner = np.flatnonzero(wide)
    starts, polygon = (np.cumsum(sizes) - sizes)[polygon[wide]], polygon[wide]
    place, around = corner - starts, sizes[polygon]
    here = points[corner]
    incoming = here - points[starts + (place - 1) % around]
    outgoing = points[starts + (place + 1) % around] - here
    with np.errstate(invalid="ignore", over="ignore"):  # non-finite values are reported by the loader
        normals = np.zeros((len(sizes), 3))  # Newell: twice the area vector
        np.add.at(normals, polygon, np.cross(here - points[starts], outgoing))
        normals = normals[polygon]
        turn = np.einsum("cd,cd->c", np.cross(incoming, outgoing), normals)
        scale = np.prod([np.linalg.norm(v, axis=1) for v in (incoming, outgoing, normals)], axis=0)
        back = turn < -_TURN * scale
        return polygon[back], place[back]


def ear_clipped(points: np.ndarray, rings: tuple[int, ...] = ()) -> np.ndarray:  # [F, 3] indices of ``points``
    """Return the triangles of one planar polygon with C corners.

    ``rings`` are the end indices of its outline and of its holes in ``points``; () means no holes.
    """
    import mapbox_earcut

    if len(points) > _MAX_CORNERS:
        raise UnreadableMesh(
            f"one of its concave polygons has {len(points):,} corners, more than {_MAX_CORNERS:,}: triangulate it"
        )
    if not np.isfinite(points).all():  # reported by the loader
        return np.array([[0, k, k + 1] for k in range(1, len(points) - 1)]).reshape(-1, 3)
    ends = np.array(rings or (len(points),), np.uint32)
    outline = points[: ends[0]]
    normal = np.cross(outline - outline[0], np.roll(outline, -1, axis=0) - outline).sum(axis=0)
    # Project along the polygon's dominant axis; the other coordinates are unchanged.
    flat = np.ascontiguousarray(np.delete(points, np.abs(normal).argmax(), axis=1), dtype=np.float64)
    triangles = mapbox_earcut.triangulate_float64(flat, ends).astype(np.int64).reshape(-1, 3)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    turned = np.cross(b - a, c - a) @ normal < 0  # ears are ordered in the 2D axes
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles
