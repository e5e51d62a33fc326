"""Remove transparent surfaces from a mesh, so that rays, voxels and surface samples agree.

Faces entirely below the opacity cutoff are removed. Faces partly below it are bisected until a piece is on one side of
the cutoff or small. A small piece is cut along a straight line, with the opacity interpolated between its corners. The
outline of an image is thus followed to a quarter of a pixel, in steps of at least 1 cm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from activestructure_gym.scenes.loaders.mesh_parts import MeshPart
from activestructure_gym.scenes.loaders.opacity import Opacity, OpacityPicture

FINEST = 0.01  # metres; shorter edges of pieces are not split
_PER_PIXEL = 4.0  # edges shorter than 1 / 4 pixel of the opacity image are not split
_MAX_PIECES = 300_000  # maximum number of pieces per file; for more, FINEST is doubled
_MIN_AREA_M2 = 1e-12  # m^2, minimum area of a piece; smaller pieces are dropped
_MAX_COORDINATE_PX = 1e6  # pixels; coordinates are clipped to this distance from the image's corner
_PICTURES_AT_ONCE = 4  # number of images whose lookup tables are kept, 20 MB each
_OPAQUE = 0.99  # opacity below which a point is translucent


@dataclass(frozen=True)
class CutOut:
    """Count the faces that were removed or cut because of their opacity."""

    gone: int = 0  # number of faces removed
    cut: int = 0  # number of faces replaced by their solid pieces
    pieces: int = 0  # number of these pieces
    translucent: int = 0  # number of translucent faces treated as solid
    finest: float = FINEST  # metres, minimum length of an edge that is split

    def notes(self) -> list[str]:
        """Return the messages for the user, one for each nonzero count."""
        said = []
        if self.gone:
            said.append(f"{self.gone} faces are transparent in the file and are left out")
        if self.cut:
            said.append(
                f"{self.cut} faces are transparent in parts and are cut into {self.pieces} solid pieces, with details "
                f"down to {100 * self.finest:g} cm"
            )
        if self.translucent:
            said.append(f"{self.translucent} faces are translucent in the file (opacity of 0.5 or more) and solid here")
        return said


class _TooMany(Exception):
    """Signal that there would be more than `_MAX_PIECES` pieces."""


def cut_out(parts: Sequence[MeshPart], metres_per_unit: float = 1.0) -> tuple[list[MeshPart], CutOut]:
    """Return ``parts`` without their transparent surfaces, and the counts; entirely solid parts are unchanged."""
    finest = FINEST
    while True:
        try:
            return _cut_all(parts, metres_per_unit, finest)
        except _TooMany:
            finest *= 2.0


def _cut_all(parts: Sequence[MeshPart], metres_per_unit: float, finest: float) -> tuple[list[MeshPart], CutOut]:
    kept: list[MeshPart] = []
    found = CutOut(finest=finest)
    pictures: dict[tuple[int, tuple[int, int]], OpacityPicture] = {}  # consecutive parts often share one
    for part in parts:
        if part.opacity is None:
            kept.append(part)
            continue
        view = _View.of(part, part.opacity, metres_per_unit, pictures)
        solid, more = _cut(part, part.opacity, view, finest, _MAX_PIECES - found.pieces)
        kept += [solid] if len(solid.faces) else []
        found = replace(found, **{name: getattr(found, name) + getattr(more, name) for name in _COUNTED})
    return kept, found


_COUNTED = ("gone", "cut", "pieces", "translucent")


def _cut(part: MeshPart, opacity: Opacity, view: _View, finest: float, most: int) -> tuple[MeshPart, CutOut]:
    whole = np.arange(len(part.faces))
    corners = np.tile(np.eye(3), (len(whole), 1, 1))  # of each piece, as barycentric weights of its face's corners
    lowest, highest = view.bounds(whole, corners)
    solid, mixed = lowest >= opacity.threshold, (lowest < opacity.threshold) & (highest >= opacity.threshold)
    face, corners = view.pieces(whole[mixed], corners[mixed], finest, most)
    has_piece = np.bincount(face, minlength=len(whole)) > 0
    translucent = solid & (lowest < _OPAQUE) & opacity.blended
    found = CutOut(int((~solid & ~has_piece).sum()), int(has_piece.sum()), len(face), int(translucent.sum()))
    if solid.all():
        return replace(part, opacity=None), found
    used, faces = np.unique(part.faces[solid], return_inverse=True)
    first = len(used) + np.arange(len(face), dtype=np.int64)[:, None] * 3

    def joined(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[used], view.interpolated(values, face, corners).reshape(-1, values.shape[1])])

    return (
        replace(
            part,
            vertices=joined(np.asarray(part.vertices, dtype=np.float64)),
            faces=np.concatenate([faces.reshape(-1, 3), first + [0, 1, 2]]),
            colors=joined(part.colors) if np.ndim(part.colors) == 2 else part.colors,
            uv=joined(part.uv) if part.uv is not None else None,
            opacity=None,
        ),
        found,
    )


@dataclass(frozen=True)
class _View:
    """Hold the geometry of a part and the opacity of its points."""

    faces: np.ndarray  # [F, 3]
    positions: np.ndarray  # [V, 3] metres
    values: np.ndarray  # [V] opacity without the image
    pixels: np.ndarray  # [V, 2] positions in the image
    picture: OpacityPicture | None
    threshold: float

    @classmethod
    def of(
        cls,
        part: MeshPart,
        opacity: Opacity,
        metres: float,
        pictures: dict[tuple[int, tuple[int, int]], OpacityPicture],
    ) -> _View:
        count = len(part.vertices)
        picture, pixels = None, np.zeros((count, 2))
        if opacity.picture is not None and opacity.uv is not None:
            key = (id(opacity.picture), opacity.wrap)
            if key not in pictures:
                if len(pictures) > _PICTURES_AT_ONCE:
                    pictures.clear()
                pictures[key] = OpacityPicture(opacity.picture, opacity.wrap)
            picture = pictures[key]
            pixels = np.nan_to_num(np.asarray(opacity.uv, dtype=np.float64) * picture.size, nan=0.0)
        return cls(
            faces=np.asarray(part.faces),
            positions=np.asarray(part.vertices, dtype=np.float64) * metres,
            values=opacity.at_vertices(count),
            pixels=np.clip(pixels, -_MAX_COORDINATE_PX, _MAX_COORDINATE_PX),
            picture=picture,
            threshold=opacity.threshold,
        )

    def interpolated(self, values: np.ndarray, face: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Interpolate vertex values [V, K] or [V] at the corners of P triangles; return [P, 3, K] or [P, 3].

        ``face`` [P] is the face that contains each triangle. ``corners`` [P, 3, 3] holds the barycentric weights of its
        corners.
        """
        if values.ndim == 1:
            return np.einsum("pij,pj->pi", corners, values[self.faces[face]])
        return np.einsum("pij,pjk->pik", corners, np.asarray(values[self.faces[face]], dtype=np.float64))

    def bounds(self, face: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # [P] each
        """Return lower and upper bounds of the opacity over each of P pieces.

        ``face`` [P] is the face that contains the piece, ``corners`` [P, 3, 3] are barycentric weights of its corners.
        """
        values = self.interpolated(self.values, face, corners)
        lowest, highest = values.min(axis=1), values.max(axis=1)
        if self.picture is None:
            return lowest, highest
        pixels = self.interpolated(self.pixels, face, corners)
        low, high = self.picture.bounds(pixels.min(axis=1), pixels.max(axis=1))
        return lowest * low, highest * high

    def pieces(self, face: np.ndarray, corners: np.ndarray, finest: float, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the solid pieces of partly transparent faces: face [P] and barycentric corners [P, 3, 3] of each.

        Edges shorter than ``finest`` metres are not split. Raises `_TooMany` for more than about ``most`` pieces.
        """
        most += 2 * len(face)  # at least one cut per face
        done: list[tuple[np.ndarray, np.ndarray]] = []
        total = 0
        while len(face):
            edge = self._edges(face, corners, finest)  # [P, 3], above 1 for edges to split
            small = edge.max(axis=1) <= 1.0
            done.append(
                _clipped(face[small], corners[small], self._opacity(face[small], corners[small]), self.threshold)
            )
            total += len(done[-1][0])
            face, corners = _halves(face[~small], corners[~small], edge[~small].argmax(axis=1))
            lowest, highest = self.bounds(face, corners)
            solid = lowest >= self.threshold
            done.append((face[solid], corners[solid]))
            total += int(solid.sum())
            mixed = ~solid & (highest >= self.threshold)
            face, corners = face[mixed], corners[mixed]
            if total + len(face) > most:
                raise _TooMany
        face, corners = (np.concatenate(list(one)) for one in zip((face, corners), *done))
        sides = self.interpolated(self.positions, face, corners)
        doubled = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
        has_area = doubled > 2.0 * _MIN_AREA_M2
        return face[has_area], corners[has_area]

    def _edges(self, face: np.ndarray, corners: np.ndarray, finest: float) -> np.ndarray:
        """Return the length [P, 3] of each edge relative to the minimum length of an edge that is split.

        Lengths are compared in metres and in pixels of the image, and the smaller ratio counts. Edge k is from corner k
        to the next one.
        """
        if self.picture is None:  # linear opacity: one cut is exact
            return np.zeros((len(face), 3))
        metres, pixels = (
            np.linalg.norm(np.roll(ends, -1, axis=1) - ends, axis=2)
            for ends in (self.interpolated(values, face, corners) for values in (self.positions, self.pixels))
        )
        return np.minimum(metres / finest, _PER_PIXEL * pixels)

    def _opacity(self, face: np.ndarray, corners: np.ndarray) -> np.ndarray:  # [P, 3]
        values = self.interpolated(self.values, face, corners)
        if self.picture is None:
            return values
        return values * self.picture.at(self.interpolated(self.pixels, face, corners))


def _halves(face: np.ndarray, corners: np.ndarray, edge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split each of P pieces at the midpoint of its edge ``edge`` [P]; return face and corners of all halves."""
    a, b, c = _from(corners, edge)
    middle = 0.5 * (a + b)
    halves = [np.stack(half, axis=1) for half in ((a, middle, c), (middle, b, c))]
    return np.concatenate([face, face]), np.concatenate(halves)


def _clipped(
    face: np.ndarray, corners: np.ndarray, opacity: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return face and corners of the solid part of each piece, with ``opacity`` [P, 3] linear between its corners."""
    solid = opacity >= threshold
    count = solid.sum(axis=1)
    found = [(face[count == 3], corners[count == 3])]
    for number in (1, 2):  # number of solid corners
        some = count == number
        odd = (solid[some] if number == 1 else ~solid[some]).argmax(axis=1)  # the only corner on its side
        a, b, c = _from(corners[some], odd)
        at_a, at_b, at_c = _from(opacity[some][:, :, None], odd)
        on_ab, on_ac = (a + (threshold - at_a) / (at - at_a) * (end - a) for end, at in ((b, at_b), (c, at_c)))
        shapes: Iterable[tuple[np.ndarray, ...]] = (
            [(a, on_ab, on_ac)] if number == 1 else [(on_ab, b, c), (on_ab, c, on_ac)]
        )
        found += [(face[some], np.stack(shape, axis=1)) for shape in shapes]
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])


def _from(corners: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the three corners [P, K] of each piece in order, starting at corner ``first``."""
    row = np.arange(len(corners))
    one, two, three = (corners[row, (first + k) % 3] for k in range(3))
    return one, two, three
