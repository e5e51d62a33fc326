"""Cast rays against a triangle mesh on several threads, with our own kernels."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from activestructure_gym.scenes.rays import Hits

# With fewer rays a second thread costs more time than it saves.
_RAYS_PER_THREAD = 8192


class RayCaster:
    """Hold a bounding volume hierarchy of one mesh; read-only, shared by all sensors of a process.

    The hierarchy is not pickled; it is rebuilt in another process. The kernels release the GIL while they cast, so two
    Python threads share the work. Hits are equal on every processor. Embree is twice as fast, but its hits at edges
    depend on vector instructions, and whole starts and episodes on them.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, *, threads: int = 2) -> None:
        self._vertices = np.ascontiguousarray(vertices, dtype=np.float32)  # [V, 3]
        self._faces = np.ascontiguousarray(faces, dtype=np.int32)  # [F, 3]
        self._threads = threads
        self._build()

    def _build(self) -> None:
        from activestructure_gym.scenes.traversal import Tracer  # loads numba

        self._tracer = Tracer(self._vertices, self._faces)
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0

    def __getstate__(self) -> dict[str, Any]:
        return {"_vertices": self._vertices, "_faces": self._faces, "_threads": self._threads}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build()

    def _chunks(self, count: int) -> list[slice]:
        parts = max(1, min(self._threads, count // _RAYS_PER_THREAD))
        edges = np.linspace(0, count, parts + 1).astype(int)
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]

    def _run(self, function: Any, count: int) -> list[Any]:
        chunks = self._chunks(count)
        if len(chunks) == 1:
            return [function(chunks[0])]
        if self._pool is None or self._pool_process != os.getpid():
            # A forked child inherits the pool without its threads.
            self._pool, self._pool_process = ThreadPoolExecutor(self._threads), os.getpid()
        return list(self._pool.map(function, chunks))

    def cast(self, origins: np.ndarray, directions: np.ndarray, *, fronts: bool = False) -> Hits:
        """Return the first hit of each ray; ``origins`` and ``directions`` are [N, 3] (directions of any length).

        For camera rays with z = 1 (`PinholeCamera.rays`) the returned distance is the depth. With ``fronts``, a ray
        that meets several faces in one plane hits one whose front it meets, and of these the one with the lowest
        number. Images need this: two walls back to back would show the colours of both as noise.
        """
        origins = np.ascontiguousarray(np.broadcast_to(origins, np.shape(directions)), dtype=np.float32)
        directions = np.ascontiguousarray(directions, dtype=np.float32)
        if not len(directions):
            nothing = np.zeros(0, np.float32)
            return Hits(nothing, np.zeros(0, np.int32), nothing, nothing)

        def part(chunk: slice) -> Hits:
            return self._tracer.first_hits(origins[chunk], directions[chunk], fronts=fronts)

        parts = self._run(part, len(directions))
        return parts[0] if len(parts) == 1 else Hits(*map(np.concatenate, zip(*parts)))

    def occluded(self, starts: np.ndarray, ends: np.ndarray, *, margin: float = 1e-3) -> np.ndarray:  # [N] bool
        """Return whether the mesh crosses each segment from ``starts`` to ``ends`` [N, 3].

        The last ``margin`` metres are ignored, so a segment may end on a surface.
        """
        starts = np.ascontiguousarray(np.broadcast_to(starts, np.shape(ends)), dtype=np.float32)
        directions = np.ascontiguousarray(np.asarray(ends, dtype=np.float32) - starts)
        length = np.linalg.norm(directions, axis=1)
        # Ray length = segment length: the ray parameter at the segment's end is 1.
        reach = (1.0 - margin / np.maximum(length, 1e-12)).astype(np.float32)
        if not len(directions):
            return np.zeros(0, dtype=bool)

        def part(chunk: slice) -> np.ndarray:
            return self._tracer.blocked(starts[chunk], directions[chunk], reach[chunk])

        return np.concatenate(self._run(part, len(directions))) & (reach > 0)
