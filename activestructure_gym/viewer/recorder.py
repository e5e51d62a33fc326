"""Record an episode for the viewer: decisions, poses, and the frames at which Gaussians are added and removed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.mapping.gaussian_map import MEAN
from activestructure_gym.motion import least_frames
from activestructure_gym.planes.record import GraphArrays, graph_arrays, seen_cells

if TYPE_CHECKING:
    from activestructure_gym.mapping import GaussianMap
    from activestructure_gym.reconstruction import Reconstruction

_JPEG_QUALITY = 82  # percent
_FIELDS = 14  # number of parameters per Gaussian
_CELL = 0.05  # metres: cell size that identifies Gaussians of a map that is rebuilt at every keyframe


@dataclass(frozen=True)
class Moment:
    """Hold the state before one decision: candidates, planes and images. The last one has no candidates."""

    frame: int  # number of frames used
    poses: int  # number of camera poses so far; below the frames if the agent spent frames at one pose
    row: int  # index of the chosen candidate; -1 at the end or before the choice
    candidates: (
        np.ndarray
    )  # [K, 8] position in metres and unit view direction, world; path in metres, frames to go there
    scores: np.ndarray  # [K] values of the first configured feature; NaN without features
    planes: np.ndarray  # [P, 4, 3] metres, world: corners of the rectangle around each plane's observed part
    structural: np.ndarray  # [P] bool: structural plane (part of the layout)
    tree: np.ndarray  # [E, 2] indices of the planes joined by each edge of the spanning forest
    centroids: np.ndarray  # [P, 3] metres, world
    true: bytes  # JPEG of the last keyframe's image
    rendered: bytes  # JPEG of the map rendered at that keyframe's pose
    decision: int = 0  # number of the decision in the episode, from 0

    @property
    def size(self) -> int:
        """Return the approximate number of bytes that the state adds to a page."""
        arrays = self.candidates.size + self.planes.size + self.centroids.size + self.tree.size
        return len(self.true) + len(self.rendered) + 4 * arrays


@dataclass(frozen=True)
class Film:
    """Hold the recording of an episode, or of its beginning."""

    moments: list[Moment]
    poses: np.ndarray  # [T, 4, 4] world_from_camera
    gaussians: np.ndarray  # [14, N] float32 last parameters of all Gaussians, including removed ones
    added: np.ndarray  # [N] int32 frame at which each Gaussian was added
    removed: np.ndarray  # [N] int32 frame at which each Gaussian was removed; the largest int32 if never
    bounds: np.ndarray  # [2, 3] metres, lowest and highest corner of the workspace
    camera: tuple[float, float, float, float, int, int]  # fx, fy, cx, cy in pixels, width, height


@dataclass
class _GaussianHistory:
    """Record the frames at which Gaussians are added and removed, identified by their ids."""

    # Pairs: number of ids assigned up to a frame, and that frame.
    frame_of: list[tuple[int, int]] = field(default_factory=list)
    # Removed Gaussians: parameters, ids, frame of removal.
    gone: list[tuple[np.ndarray, np.ndarray, int]] = field(default_factory=list)
    ids: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    parameters: np.ndarray = field(default_factory=lambda: np.zeros((_FIELDS, 0), np.float32))
    # Used for a map that is rebuilt at every keyframe and has no persistent ids: all cells that ever held a Gaussian,
    # and the first frame of each.
    cells: np.ndarray | None = None  # [M] int64
    cell_frames: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))  # [M]

    def note(self, gaussians: GaussianMap, frame: int) -> None:
        """Record the Gaussians present after ``frame`` frames. Called after every keyframe."""
        ids = gaussians.ids[: gaussians.count].copy()
        left = ~np.isin(self.ids, ids)
        if len(ids) and len(left) and left.all() and self.cells is None:
            self.cells = np.zeros(0, np.int64)
            self._note_cells(self.frame_of[-1][1])
        if left.any() and self.cells is None:
            self.gone.append((self.parameters[:, left], self.ids[left], frame))
        self.ids, self.parameters = ids, gaussians.parameters[:, : gaussians.count].copy()
        self.frame_of.append((gaussians.next_id, frame))
        if self.cells is not None:
            self._note_cells(frame)

    def _note_cells(self, frame: int) -> None:
        found = np.unique(_cells_of(self.parameters))
        assert self.cells is not None
        new = found[~np.isin(found, self.cells)]
        self.cells = np.concatenate([self.cells, new])
        self.cell_frames = np.concatenate([self.cell_frames, np.full(len(new), frame)])

    def gaussians(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # [14, N], [N] added, [N] removed
        """Return present and removed Gaussians with their frames of addition and removal, sorted by addition."""
        last = np.iinfo(np.int32).max
        parameters = np.concatenate([self.parameters, *(block for block, _, _ in self.gone)], axis=1)
        ids = np.concatenate([self.ids, *(ids for _, ids, _ in self.gone)])
        removed = np.concatenate(
            [np.full(len(self.ids), last), *(np.full(len(ids), frame) for _, ids, frame in self.gone)]
        )
        below, frames = np.array(self.frame_of).reshape(-1, 2).T
        added = frames[np.searchsorted(below, ids, side="right")]
        if self.cells is not None:
            order = np.argsort(self.cells)
            now = np.searchsorted(self.cells[order], _cells_of(self.parameters))
            added[: len(self.ids)] = self.cell_frames[order][now]
        order = np.argsort(added, kind="stable")
        return parameters[:, order], added[order].astype(np.int32), removed[order].astype(np.int32)


def _cells_of(parameters: np.ndarray) -> np.ndarray:  # [14, N] -> [N] int64
    """Return one integer per Gaussian that identifies the grid cell (size `_CELL`) of its mean."""
    x, y, z = np.floor(parameters[MEAN].astype(np.float64) / _CELL).astype(np.int64) + (1 << 20)
    return (x << 42) + (y << 21) + z


class Recorder:
    """Record a running episode without changing it.

    ``most_bytes`` limits the size of the states on a page in bytes. If they are larger, only every second, fourth, ...
    state is kept. None keeps all. Raises `InputError` for a mapper whose map has no Gaussians.
    """

    def __init__(self, episode: Reconstruction, *, most_bytes: int | None = None) -> None:
        if not hasattr(episode.mapper, "map"):
            raise InputError("a recording needs a map of Gaussians, and this mapper has another kind of map")
        self.moments: list[Moment] = []
        self._most_bytes, self._bytes = most_bytes, 0
        self._noted, self.every = 0, 1  # number of states seen so far, and the interval at which they are kept
        self._episode, self._history = episode, _GaussianHistory()
        self._poses = episode.trajectory  # of this episode, also after the environment has started another one
        self._lock = threading.Lock()  # recordings are read while the episode runs
        self._history.note(episode.mapper.map, episode.frames)
        after_keyframes(episode, self._keep)

    def _keep(self) -> None:
        with self._lock:
            self._history.note(self._episode.mapper.map, self._episode.frames)

    def note(self, row: int = -1, *, end: bool = False) -> None:
        """Record the current state. ``row`` is the index of the candidate chosen next, or -1.

        ``end`` forces keeping.
        """
        with self._lock:
            self._history.note(self._episode.mapper.map, self._episode.frames)
            number, self._noted = self._noted, self._noted + 1
            if end or number % self.every == 0:
                self.moments.append(replace(moment_of(self._episode, row), decision=number))
                self._bytes += self.moments[-1].size
            while self._most_bytes is not None and self._bytes > self._most_bytes and len(self.moments) > 2:
                self.every *= 2
                *before, last = self.moments
                self.moments = [moment for moment in before if moment.decision % self.every == 0] + [last]
                self._bytes = sum(moment.size for moment in self.moments)

    def choose(self, row: int) -> None:
        """Set the index of the candidate chosen at the last recorded state."""
        self.moments[-1] = replace(self.moments[-1], row=row)

    def film(self, first: int = 0) -> Film:
        """Return the recording from state ``first`` on; its poses begin at the state before that one."""
        episode, camera = self._episode, self._episode.config.sensor.camera
        with self._lock:
            gaussians, added, removed = self._history.gaussians()
        begun, end = (self.moments[n].poses if n >= 0 else 0 for n in (first - 1, len(self.moments) - 1))
        return Film(
            moments=self.moments[first:],
            poses=np.array(self._poses[begun:end]).reshape(-1, 4, 4),
            gaussians=gaussians,
            added=added,
            removed=removed,
            bounds=np.asarray(episode.bounds, float),
            camera=(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height),
        )


def after_keyframes(episode: Reconstruction, act: Callable[[], None]) -> None:
    """Call ``act`` after each later keyframe of this episode has been mapped."""
    observe = episode.mapper.observe

    def watched(*given: Any, **options: Any) -> Any:
        """Map the keyframe, then call ``act``; return the mapper's report."""
        report = observe(*given, **options)
        act()
        return report

    episode.mapper.observe = watched  # type: ignore[method-assign]


def moment_of(episode: Reconstruction, row: int = -1) -> Moment:
    """Return the current state of an episode; ``row`` is the index of the chosen candidate, -1 if none is chosen."""
    graph, frame = graph_arrays(episode.planes), episode.mapper.keyframes[-1]
    table = episode.candidates
    poses, lengths, stay = (rows[: table.views] for rows in (table.world_from_camera, table.path_length, table.stay))
    frames = least_frames(episode.pose, poses, lengths, episode.config.motion)
    frames = np.where(stay > 0, stay * episode.config.keyframe_every, frames)
    scores = np.full(len(poses), np.nan)
    if episode.config.features:
        scores = np.clip(episode.features[: len(poses), 0], -1e6, 1e6)
    rendered = episode.mapper.render(frame.camera, frame.world_from_camera).color
    return Moment(
        frame=episode.frames,
        poses=len(episode.trajectory),
        row=row,
        candidates=np.column_stack([poses[:, :3, 3], poses[:, :3, 2], lengths, frames]),
        scores=scores.astype(float),
        planes=plane_rectangles(graph),
        structural=graph["structural"],
        tree=graph["edges"][graph["edge_in_tree"]],
        centroids=graph["centroids"],
        true=_jpeg(frame.rgb),
        rendered=_jpeg((np.clip(rendered, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)),
    )


def plane_rectangles(graph: GraphArrays) -> np.ndarray:  # [P, 4, 3] metres
    """Return the corners of the smallest rectangle around the observed part of each plane, in order around it.

    For a plane without observed cells all four corners are its centroid.
    """
    found = np.repeat(np.asarray(graph["centroids"], float).reshape(-1, 1, 3), 4, axis=1)
    for k in range(len(found)):
        cells = np.argwhere(seen_cells(graph, k))
        if len(cells):
            # Use all four corners of each cell, so that a single row of cells has a width.
            corners = np.concatenate([cells + offset for offset in ((0, 0), (0, 1), (1, 0), (1, 1))])
            box = cv2.boxPoints(cv2.minAreaRect(corners.astype(np.float32)))
            found[k] = graph["patch_corners"][k] + graph["cell"] * (box @ graph["patch_axes"][k])
    return found


def _jpeg(rgb: np.ndarray) -> bytes:  # [H, W, 3] uint8
    _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()
