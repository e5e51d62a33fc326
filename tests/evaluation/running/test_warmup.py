"""Before a comparison its kernels are compiled, with a count; nothing is done where they are on disk."""

from __future__ import annotations

import time

import pytest

from activestructure_gym.compiling import ahead, progress
from activestructure_gym.evaluation.running.warmup import feature_modules, warming_up


class Listed:
    """Stand for a kernel of the list."""

    def __init__(self, kept: bool) -> None:
        self.kept = kept
        self.compiled = 0

    def is_kept(self) -> bool:
        return self.kept

    def compile(self) -> None:
        self.compiled += 1


@pytest.fixture
def listed(monkeypatch) -> list[Listed]:
    kernels = [Listed(kept) for kept in (False, True, False)]
    monkeypatch.setattr(ahead, "listed_kernels", lambda features: kernels)
    return kernels


def test_missing_kernels_are_compiled_by_helpers_and_after_the_block_with_a_total(listed, monkeypatch):
    helped, said = [], []
    monkeypatch.setattr(ahead, "start_helpers", helped.extend)
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with warming_up(["random"], said.append):
        now[0] = 60.0  # the time of the block is not that of the kernels
        assert helped == [listed[0], listed[2]] and said == [progress.describe(0, 0.0, 2)]
        assert not any(each.compiled for each in listed)
    assert [each.compiled for each in listed] == [1, 0, 1]
    assert said[1:] == [*(progress.describe(number, 0.0, 2) for number in (1, 2)), "all kernels are compiled"]


def test_nothing_is_started_or_said_where_all_is_compiled(listed, monkeypatch):
    monkeypatch.setattr(ahead, "start_helpers", lambda kernels: pytest.fail("started"))
    for each in listed:
        each.kept = True
    with warming_up(["random"], lambda line: pytest.fail(line)):
        pass


def test_nothing_is_compiled_after_a_block_that_fails(listed, monkeypatch):
    monkeypatch.setattr(ahead, "start_helpers", lambda kernels: None)
    with pytest.raises(KeyError), warming_up(["random"]):
        raise KeyError
    assert not any(each.compiled for each in listed)


def test_the_features_are_those_of_all_policies():
    found = feature_modules(["random", "pixel_only", "activestructure"])
    assert "activestructure_gym.features.unknown_volume" in found and len(found) > 1
