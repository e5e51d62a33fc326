"""The candidate table of a stage: what its sources propose and can be reached, and rows that ask for other stages."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from activestructure_gym.errors import InputError
from activestructure_gym.motion import is_level
from activestructure_gym.sources.base import MAX_ROWS, Proposals, Source, SourceContext, make_source
from activestructure_gym.views import CandidateTable

Stages = tuple[tuple[str, ...], ...]


def make_stages(names: Stages, rows: int) -> dict[str, Source]:
    """The sources of all stages by what they are called there.

    Raises `InputError` for what `make_source` refuses, and for a stage that does not fit into ``rows``.
    """
    made = {name: make_source(name) for stage in names for name in stage}
    for stage in names:
        # The shared pool takes what is left; one row is the least.
        needed = sum(1 if made[name].rows == MAX_ROWS else made[name].rows for name in stage) + len(names) - 1
        if needed > rows:
            raise InputError(
                f"the stage {', '.join(stage)} needs {needed} rows and views.max_candidates is {rows}: raise it, or "
                "give the sources fewer rows (as in 'around?rows=32')"
            )
    return made


def random_of(seed: int, decision: int, name: str) -> np.random.Generator:
    """The generator of the source called ``name`` at one decision of the episode with this seed."""
    return np.random.default_rng([seed, decision, zlib.crc32(name.encode())])


def offer(
    stage: Sequence[str],
    made: dict[str, Source],
    context: Callable[[str, int], SourceContext],  # name, room
    *,
    rows: int,
    asks: Iterable[int] = (),  # the stages that may be asked for
) -> CandidateTable:
    """The table: the sources in their order, then a row for every stage in ``asks``."""
    asks, names = list(asks), list(made)
    parts: list[CandidateTable] = []
    left = rows - len(asks)
    for place, name in enumerate(stage):
        source = made[name]
        # What the later sources may need stays free.
        kept = sum(1 if made[later].rows == MAX_ROWS else made[later].rows for later in stage[place + 1 :])
        room = min(left - kept, source.rows)
        seen = context(name, room)
        part = _reachable(_checked(name, source.propose(seen), seen.agent.pose), seen, room, names.index(name))
        left -= len(part)
        parts.append(part)
    if asks:
        parts.append(_asking(asks, seen.agent.pose))
    return parts[0] if len(parts) == 1 else CandidateTable.joined(parts)


def _checked(
    name: str,
    proposed: object,
    present: np.ndarray,  # [4, 4] the agent's pose
) -> Proposals:
    """What the source called ``name`` returned, if it is what the table can take.

    Raises `InputError` where it is no `Proposals`, and for poses that no camera on a level base can take. A camera that
    is led along somebody's path may roll: its keyframes, which the pool offers again, and where it is now.
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
            f"{np.sum(~good)} of the {len(poses)} poses of the source '{name}' are no rotation or have roll: make them "
            "with geometry.look_along"
        )
    return proposed


def _reachable(proposed: Proposals, context: SourceContext, room: int, source: int) -> CandidateTable:
    """The first proposals that can be reached, as rows."""
    poses, distances = np.asarray(proposed.world_from_camera, dtype=np.float64), context.agent.distances
    places = poses[:, :3, 3]
    lengths = distances.at(places) if len(poses) else np.zeros(0, np.float32)
    good = np.isfinite(lengths)
    if proposed.ids is None:  # the pool has looked already, and a keyframe's pose may be where it is narrow
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
