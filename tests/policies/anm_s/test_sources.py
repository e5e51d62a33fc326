"""ANM-S's candidates: the nodes of the floor plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from activestructure_gym.motion import planar_graph
from activestructure_gym.sources import Proposals, Source, SourceContext, make_source
from tests.sources.test_sources import TURNS, look_round, rows_of


def test_nodes_are_those_of_the_floor_plan_and_are_come_back_to() -> None:
    spec = "nodes?yaws=6&rows=60"
    run = look_round((TURNS, spec))
    nodes = planar_graph(run.volume, run.trajectory[0][:3, 3]).nodes
    poses = run.candidates.world_from_camera[rows_of(run, spec)]
    assert len(poses) and len(poses) % 6 == 0
    assert np.linalg.norm(poses[:, None, :2, 3] - nodes, axis=2).min(axis=1).max() < 1e-9
    seen: dict[str, SourceContext] = {}

    @dataclass(frozen=True)
    class Look(Source):
        rows: int = 60

        def propose(self, context):
            seen["context"] = context
            return Proposals(poses)

    run._sources = {TURNS: make_source(TURNS), spec: Look()}
    run._offer()
    context, nodes_source = seen["context"], make_source(spec)
    been = replace(context, agent=replace(context.agent, stops=poses[:1]))
    np.testing.assert_allclose(nodes_source.propose(been).world_from_camera, poses, atol=1e-9)
    there = replace(context, agent=replace(context.agent, pose=poses[0]))
    np.testing.assert_allclose(nodes_source.propose(there).world_from_camera, poses[1:], atol=1e-9)
