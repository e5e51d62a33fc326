"""Record the Plane Scene Graph of a run: arrays for drawing it, and a summary per decision."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from activestructure_gym.planes import PlaneSceneGraph

GraphArrays = Mapping[str, np.ndarray]


def graph_arrays(graph: PlaneSceneGraph) -> dict[str, np.ndarray]:
    """Return the content of ``graph.npz``: N planes, E edges, D deficiency centres, in metres and the world frame.

    Planes: ``ids`` [N], ``normals`` [N, 3] and ``offsets`` [N] with normal . x + offset = 0, ``centroids`` [N, 3],
    ``areas`` [N] m^2, ``observations`` [N] keyframes, ``structural`` [N] bool. Then ``modes`` [N, 8] in the order of
    ``mode_names`` [8], ``quality`` [N], ``surprise`` [N] and its three factors ``surprise_factors`` [N, 3]
    (connectivity, neighbourhood, geometric), ``deficit`` [N], ``betweenness`` [N].

    Edges: ``edges`` [E, 2] plane rows, ``edge_weights`` [E], ``edge_in_tree`` [E] bool.

    Deficiency centres: ``deficiency_centres`` [D, 3], ``deficiency_normals`` [D, 3], ``deficiency_areas`` [D] m^2,
    ``deficiency_planes`` [D] plane rows.

    Seen surface: plane k is a grid of ``patch_shapes[k]`` = (R, C) square cells of edge ``cell``. The corner of cell
    (r, c) is ``patch_corners[k] + cell * (r * patch_axes[k, 0] + c * patch_axes[k, 1])``. The mask of seen cells is
    packed eight to a byte, row by row: ``np.unpackbits(patch_bits[patch_starts[k]:patch_starts[k + 1]])[:R * C]``.
    """
    from activestructure_gym.planes import QUALITY_MODES

    nodes = graph.nodes
    count = len(nodes)
    corners, axes = np.zeros((count, 3)), np.zeros((count, 2, 3))
    shapes, starts = np.zeros((count, 2), np.int64), np.zeros(count + 1, np.int64)
    packed = [np.zeros(0, np.uint8)]
    for k, node in enumerate(nodes):
        surface = node.surface
        rows, columns = np.nonzero(surface.seen)
        low = np.array([rows.min(), columns.min()] if len(rows) else [0, 0])
        high = np.array([rows.max() + 1, columns.max() + 1] if len(rows) else [0, 0])
        axes[k] = surface.axes[:2]
        corners[k] = surface.cell_centres(low[:1], low[1:])[0] - 0.5 * surface.cell * axes[k].sum(axis=0)
        shapes[k] = high - low
        packed.append(np.packbits(surface.seen[low[0] : high[0], low[1] : high[1]] > 0))
        starts[k + 1] = starts[k] + len(packed[-1])
    first, second = np.nonzero(np.triu(graph.state.edges, 1))
    surprise, holes = graph.state.surprise, graph.deficiencies
    return {
        "ids": np.array([node.id for node in nodes], dtype=np.int64),
        "normals": graph.state.normals,
        "offsets": graph.state.offsets,
        "centroids": graph.state.centroids,
        "areas": graph.state.areas,
        "observations": np.array([node.observations for node in nodes], dtype=np.int64),
        "structural": np.asarray(graph.state.structural, dtype=bool),
        "mode_names": np.array(QUALITY_MODES),
        "modes": graph.state.quality.modes,
        "quality": graph.state.quality.scores,
        "surprise": surprise.total,
        "surprise_factors": np.stack([surprise.connectivity, surprise.neighbourhood, surprise.geometric], axis=1),
        "deficit": graph.state.deficit,
        "betweenness": graph.state.betweenness,
        "edges": np.stack([first, second], axis=1).astype(np.int64),
        "edge_weights": graph.state.weights[first, second],
        "edge_in_tree": graph.state.tree[first, second],
        "deficiency_centres": holes.centres,
        "deficiency_normals": holes.normals,
        "deficiency_areas": holes.areas,
        "deficiency_planes": holes.planes,
        "cell": np.array(graph.config.cell),
        "patch_corners": corners,
        "patch_axes": axes,
        "patch_shapes": shapes,
        "patch_starts": starts,
        "patch_bits": np.concatenate(packed),
    }


def seen_cells(arrays: GraphArrays, plane: int) -> np.ndarray:  # [R, C] uint8, 1 = seen
    """Return the mask of seen grid cells of the plane in row ``plane``.

    `graph_arrays` defines the world position of each cell.
    """
    rows, columns = (int(side) for side in arrays["patch_shapes"][plane])
    start, end = arrays["patch_starts"][plane : plane + 2]
    return np.unpackbits(arrays["patch_bits"][start:end])[: rows * columns].reshape(rows, columns)


def graph_summary(graph: PlaneSceneGraph) -> dict[str, Any]:
    """Return numbers and means over the planes for the record of a decision; a mean over no planes is None."""
    structural = np.asarray(graph.state.structural, dtype=bool)
    summary: dict[str, Any] = {}
    for kind, own in (("structural", structural), ("objects", ~structural)):
        summary[kind] = int(own.sum())
        summary[f"deficit_{kind}"] = _mean(graph.state.deficit[own])
        summary[f"quality_{kind}"] = _mean(graph.state.quality.scores[own])
    return summary | {
        "deficit": _mean(graph.state.deficit),
        "quality": _mean(graph.state.quality.scores),
        "deficiency_centres": len(graph.deficiencies),
        "deficiency_area": float(graph.deficiencies.areas.sum()),  # m^2
    }


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None
