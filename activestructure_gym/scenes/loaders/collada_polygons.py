"""Convert the polygons of a COLLADA <mesh> to triangles over its corners."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from activestructure_gym.scenes.loaders.collada_numbers import integers
from activestructure_gym.scenes.loaders.damage import UnreadableMesh
from activestructure_gym.scenes.loaders.polygons import ear_clipped, triangulated

Element = ElementTree.Element


@dataclass(frozen=True)
class Input:
    """Hold one property of corners, such as the position: its values, and the column of its index in <p>."""

    semantic: str
    column: int
    values: np.ndarray  # [N, stride]

    def of(self, corners: np.ndarray, width: int) -> np.ndarray:  # [C, columns of <p>] -> [C, width]
        """Return the first ``width`` numbers of the property at each corner.

        Raises `UnreadableMesh` for an index out of range and for values with fewer numbers.
        """
        index = corners[:, self.column]
        if len(index) and (index.min() < 0 or index.max() >= len(self.values)):
            raise UnreadableMesh(f"a corner has the {self.semantic} {index.max()}, but there are {len(self.values)}")
        if self.values.shape[1] < width:
            raise UnreadableMesh(f"its {self.semantic} values have {self.values.shape[1]} numbers instead of {width}")
        return self.values[index, :width]


def corners_and_triangles(primitives: Element, width: int, positions: Input) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners [C, width] of a polygon element, which are the rows of <p>, and triangles [F, 3] over them.

    ``positions`` are needed to split polygons. Concave outlines and holes of polygons are preserved.
    """
    rows = [_rows(p, width) for p in primitives.findall("p")]
    corners = np.concatenate(rows) if rows else np.zeros((0, width), np.int64)
    sizes = np.array([len(row) for row in rows], dtype=np.int64)
    if primitives.tag == "triangles":
        return corners, np.arange(len(corners) // 3 * 3).reshape(-1, 3)
    if primitives.tag in ("tristrips", "trifans"):
        return corners, _strips(sizes, fans=primitives.tag == "trifans")
    if primitives.tag == "polylist":
        sizes = integers(primitives.findtext("vcount"))
        if (sizes < 0).any() or (sizes > len(corners)).any() or sizes.sum() > len(corners):
            raise UnreadableMesh(f"a <polylist> counts {sizes.sum()} corners and has {len(corners)}")
        corners = corners[: sizes.sum()]
    triangles, _ = triangulated(positions.of(corners, 3), sizes)
    for holed in primitives.findall("ph"):
        rings = [_rows(ring, width) for ring in holed if ring.tag in ("p", "h") and ring.text]
        if not rings:
            continue
        outline = np.concatenate(rings)
        ends = tuple(np.cumsum([len(ring) for ring in rings]).tolist())
        triangles = np.concatenate([triangles, len(corners) + ear_clipped(positions.of(outline, 3), ends)])
        corners = np.concatenate([corners, outline])
    return corners, triangles


def _rows(indices: Element, width: int) -> np.ndarray:  # [C, width]
    flat = integers(indices.text)
    if len(flat) % width:
        raise UnreadableMesh(f"a <{indices.tag}> has {len(flat)} indices, which are not rows of {width}")
    return flat.reshape(-1, width)


def _strips(sizes: np.ndarray, *, fans: bool) -> np.ndarray:  # [F, 3]
    """Return the triangles of concatenated strips with ``sizes`` corners each, or of fans.

    The triangles of a fan share its first corner.
    """
    counts = np.maximum(sizes - 2, 0)
    starts = np.repeat(np.cumsum(sizes) - sizes, counts)
    k = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([starts if fans else starts + k, starts + k + 1, starts + k + 2], axis=1)
