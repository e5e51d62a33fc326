"""Two finished runs: one in a scene, one in a world."""

from __future__ import annotations

import pytest

from activestructure_gym.evaluation import Conditions, compare
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.protocols import StandardProtocol
from tests.bare_jobs import bare_jobs

WORLD = "world:simulated?scene=box&width=48&height=36"
PROTOCOL = StandardProtocol(surface_samples=20_000, views=2, tsdf_voxel_m=0.05, tsdf_truncation_m=0.15)
SMALL = Conditions(preset="fast", frame_budget=30, protocol=PROTOCOL)


def _played(scene: str, place: pytest.TempPathFactory) -> Run:
    with bare_jobs():
        return compare([scene], ["random"], place.mktemp("run") / "out", conditions=SMALL, engine="inline").runs[0]


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return _played("box", tmp_path_factory)


@pytest.fixture(scope="session")
def world_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return _played(WORLD, tmp_path_factory)
