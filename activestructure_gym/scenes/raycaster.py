"""Cast rays against a triangle mesh on several threads: with Embree, or with our own kernels where it is missing."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from typing import Any

import numpy as np

from activestructure_gym.errors import InputError, short_repr
from activestructure_gym.scenes.rays import Hits, Tracer

SWITCH = "ASG_RAYCASTER"  # environment variable
EMBREE, NUMBA = "embree", "numba"
# With fewer rays a second thread costs more time than it saves.
_RAYS_PER_THREAD = 8192


def tracer_in_use() -> tuple[str, str]:
    """Return the name of the tracer that new ray casters use, `EMBREE` or `NUMBA`, and the reason.

    It is Embree if the package embreex can be imported. ``ASG_RAYCASTER=embree`` or ``numba`` in the environment
    overrides this.

    Raises
    ------
    InputError
        If the variable has another value, or names Embree and embreex cannot be imported.
    """
    asked = os.environ.get(SWITCH, "")
    if asked not in ("", EMBREE, NUMBA):
        raise InputError(f"{SWITCH} must be {EMBREE} or {NUMBA}, got {short_repr(asked)}: correct it or unset it")
    if asked == NUMBA:
        return NUMBA, f"{SWITCH}={asked}"
    try:
        import_module("embreex.rtcore_scene")
    except ImportError as error:
        if asked:
            raise InputError(
                f"{SWITCH}={asked} needs the package embreex, which cannot be imported ({error}): install it or unset "
                f"{SWITCH}"
            ) from None
        return NUMBA, f"embreex cannot be imported: {error}"
    return EMBREE, f"{SWITCH}={asked}" if asked else "default"


def _make_tracer(vertices: np.ndarray, faces: np.ndarray, name: str) -> Tracer:
    if name == EMBREE:
        from activestructure_gym.scenes.embree import EmbreeTracer

        return EmbreeTracer(vertices, faces)
    from activestructure_gym.scenes.traversal import NumbaTracer

    return NumbaTracer(vertices, faces)


class RayCaster:
    """Hold a bounding volume hierarchy of one mesh; read-only, shared by all sensors of a process.

    The hierarchy is not pickled; it is rebuilt in another process. Both tracers release the GIL while they cast, so two
    Python threads share the work. ``tracer`` is `EMBREE` or `NUMBA`; None is that of `tracer_in_use`. Hits of `NUMBA`
    are equal on every processor, those of Embree are not: at edges they depend on its vector instructions.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, *, threads: int = 2, tracer: str | None = None) -> None:
        self._vertices = np.ascontiguousarray(vertices, dtype=np.float32)  # [V, 3]
        self._faces = np.ascontiguousarray(faces, dtype=np.int32)  # [F, 3]
        self._threads = threads
        self._asked = tracer
        self._build()

    def _build(self) -> None:
        self._tracer = _make_tracer(self._vertices, self._faces, self._asked or tracer_in_use()[0])
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0

    def __getstate__(self) -> dict[str, Any]:
        return {"_vertices": self._vertices, "_faces": self._faces, "_threads": self._threads, "_asked": self._asked}

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

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """Return the first hit of each ray; ``origins`` and ``directions`` are [N, 3] (directions of any length).

        For camera rays with z = 1 (`PinholeCamera.rays`) the returned distance is the depth.
        """
        origins = np.ascontiguousarray(np.broadcast_to(origins, np.shape(directions)), dtype=np.float32)
        directions = np.ascontiguousarray(directions, dtype=np.float32)
        if not len(directions):
            nothing = np.zeros(0, np.float32)
            return Hits(nothing, np.zeros(0, np.int32), nothing, nothing)

        def part(chunk: slice) -> Hits:
            return self._tracer.first_hits(origins[chunk], directions[chunk])

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
