"""A short finished run, and its recording."""

from __future__ import annotations

from dataclasses import replace

import pytest

from activestructure_gym.evaluation import StandardProtocol, compare
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.replay import Recording, play_again


@pytest.fixture(scope="package")
def finished(tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """`hole_area` and `random` in the box room, with a map that is optimised."""
    result = compare(
        ["box"],
        ["hole_area", "random"],
        tmp_path_factory.mktemp("replay") / "runs",
        conditions=Conditions(
            preset="fast",
            frame_budget=40,
            overrides={"mapper.iterations": 2, "keyframe_every": 5},
            protocol=replace(StandardProtocol(), views=1, view_width=64, view_height=36, surface_samples=2000),
        ),
        engine="inline",
    )
    return list(result.runs)


@pytest.fixture(scope="package")
def recordings(finished: list[Run]) -> list[Recording]:
    return [play_again(run) for run in finished]
