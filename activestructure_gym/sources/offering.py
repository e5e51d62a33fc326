"""Build the candidate table of a stage from reachable proposals, and rows that switch to other stages."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.motion import is_level
from activestructure_gym.sources.base import MAX_ROWS, Proposals, Source, SourceContext, make_source
from activestructure_gym.sources.shared_pool import Pool
from activestructure_gym.sources.standing import Finish, Stay
from activestructure_gym.views import CandidateTable

Stages = tuple[tuple[str, ...], ...]


def make_stages(names: Stages, rows: int) -> dict[str, Source]:
    """Return the sources of all stages, by their text in the configuration.

    Parameters
    ----------
    names : tuple of tuple of str
        The stages, each a tuple of sources with their options.
    rows : int
        Rows of the candidate table.

    Returns
    -------
    dict of str to Source
        The sources by name and options.

    Raises
    ------
    InputError
        `make_source` refuses a source, or a stage needs more than ``rows``.
    """
    made = {name: make_source(name) for stage in names for name in stage}
    for stage in names:
        # The shared pool takes the remaining rows, at least one.
        needed = sum(1 if made[name].rows == MAX_ROWS else made[name].rows for name in stage) + len(names) - 1
        if needed > rows:
            raise InputError(
                f"the stage {', '.join(stage)} needs {needed} rows and views.max_candidates is {rows}: raise it, or "
                "give the sources fewer rows (as in 'around?rows=32')"
            )
    return made


def only_views_of_pool(made: dict[str, Source]) -> None:
    """Check that all sources suit a world with a fixed set of camera poses.

    Parameters
    ----------
    made : dict of str to Source
        All sources, see `make_stages`.

    Raises
    ------
    InputError
        A source is not ``pool``, ``stay`` or ``finish``, so it could propose other poses.
    """
    others = [name for name, source in made.items() if not isinstance(source, Pool | Stay | Finish)]
    if others:
        raise InputError(
            f"this world has given views only, and the candidate source '{others[0]}' proposes others: use the shared "
            "setup, or only the sources pool, stay and finish in views.stages"
        )


def random_of(seed: int, decision: int, name: str) -> np.random.Generator:
    """Return the random generator of one source for one decision.

    Parameters
    ----------
    seed : int
        Seed of the episode's sources.
    decision : int
        Number of previous decisions.
    name : str
        The source, with its options.

    Returns
    -------
    numpy.random.Generator
        The generator; equal arguments give equal draws.
    """
    return np.random.default_rng([seed, decision, zlib.crc32(name.encode())])


def offer(
    stage: Sequence[str],
    made: dict[str, Source],
    context: Callable[[str, int], SourceContext],  # name of a source, its number of rows -> context
    *,
    rows: int,
    asks: Iterable[int] = (),  # indices of stages
) -> CandidateTable:
    """Return the candidate table of a stage: the views of its sources, then a row that switches to each of ``asks``.

    Parameters
    ----------
    stage : sequence of str
        Sources of the stage.
    made : dict of str to Source
        All sources, see `make_stages`.
    context : callable
        Returns the `SourceContext` for the name of a source and its number of rows.
    rows : int
        Largest number of rows of the table.
    asks : iterable of int
        Indices of the stages to which a row can switch.

    Returns
    -------
    CandidateTable
        At most ``rows`` rows.

    Raises
    ------
    InputError
        A source returns something else than `Proposals`, or poses that are not rotations or have roll.
    """
    asks, names = list(asks), list(made)
    parts: list[CandidateTable] = []
    left = rows - len(asks)
    for place, name in enumerate(stage):
        source = made[name]
        # Rows reserved for the later sources.
        kept = sum(1 if made[later].rows == MAX_ROWS else made[later].rows for later in stage[place + 1 :])
        room = min(left - kept, source.rows)
        seen = context(name, room)
        proposed = source.propose(seen)
        if type(source) is not Pool:  # the pool's poses are made here
            proposed = _checked(name, proposed, seen.agent.pose)
        part = _reachable(proposed, seen, room, names.index(name))
        left -= len(part)
        parts.append(part)
    if asks:
        parts.append(_asking(asks, seen.agent.pose))
    return parts[0] if len(parts) == 1 else CandidateTable.joined(parts)


def _checked(
    name: str,
    proposed: object,
    present: np.ndarray,  # [4, 4] pose of the agent
) -> Proposals:
    """Return the proposals of the source ``name``; raise `InputError` for other objects and for invalid poses.

    Poses must be level (without roll), with two exceptions: ``present``, and keyframe poses that the pool offers again.
    Both can have roll if the agent followed a given trajectory.
    """
    if not isinstance(proposed, Proposals):
        raise InputError(f"propose() of the source '{name}' must return Proposals, got {type(proposed).__name__}")
    poses = np.asarray(proposed.world_from_camera, dtype=np.float64)
    turns = poses[:, :3, :3]
    rotates = (np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)) < 1e-6).all(axis=(1, 2)) & (
        np.linalg.det(turns) > 0
    )
    level = is_level(poses) | (np.abs(poses - present).max(axis=(1, 2)) < 1e-9) | (proposed.ids is not None)
    if not (good := rotates & level).all():
        raise InputError(
            f"{np.sum(~good)} of the {len(poses)} poses of the source '{name}' are not rotations or have roll: make "
            "them with geometry.look_along"
        )
    return proposed


def _reachable(proposed: Proposals, context: SourceContext, room: int, source: int) -> CandidateTable:
    """Return the first ``room`` reachable proposals as rows of the table; ``source`` is the index of their source."""
    poses, distances = np.asarray(proposed.world_from_camera, dtype=np.float64), context.agent.distances
    places = poses[:, :3, 3]
    lengths = proposed.path_length
    if lengths is None:
        lengths = distances.at(places) if len(poses) else np.zeros(0, np.float32)
    good = np.isfinite(lengths)
    if proposed.ids is None:  # the pool has tested its views, and a keyframe pose can have less clearance
        good &= (context.volume.clearance_at(places) >= context.clearance_m) | (
            np.linalg.norm(places - distances.start, axis=1) < 1e-6
        )
    kept = np.nonzero(good)[0][:room]
    count = len(kept)
    return CandidateTable(
        ids=np.full(count, -1, np.int64) if proposed.ids is None else proposed.ids[kept],
        world_from_camera=poses[kept],
        path_length=lengths[kept].astype(np.float32),
        revisit=np.zeros(count, bool) if proposed.revisit is None else proposed.revisit[kept],
        source=np.full(count, source),
        look_at=np.full((count, 3), np.nan) if proposed.look_at is None else np.asarray(proposed.look_at, float)[kept],
        stay=np.full(count, proposed.stay),
        ends=np.full(count, proposed.ends),
    )


def _asking(asks: list[int], pose: np.ndarray) -> CandidateTable:
    count = len(asks)
    return CandidateTable(
        ids=np.full(count, -1, np.int64),
        world_from_camera=np.tile(pose, (count, 1, 1)),
        path_length=np.zeros(count, np.float32),
        revisit=np.zeros(count, bool),
        source=np.full(count, -1),
        ask=np.array(asks),
    )
