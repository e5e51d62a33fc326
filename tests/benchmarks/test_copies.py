"""Copies of an apartment around a place: where they stand, and what is compared."""

import numpy as np
import pytest

from activestructure_gym.mapping import GaussianMap, Mapper, MapperConfig
from activestructure_gym.scenes.library import load_scene
from benchmarks.copies import among_copies, bytes_of, run_copies_benchmark
from benchmarks.growth import STOREY


@pytest.mark.parametrize("where", ["storeys", "floor"])
def test_copies_stand_clear_of_each_other_and_the_place_stays(where):
    rng = np.random.default_rng(0)
    whole = rng.uniform(0, 1, (14, 500)).astype(np.float32)
    whole[:3] *= [[6.0], [4.0], [2.5]]
    place = Mapper(MapperConfig(), rng)
    place.map.append(whole[:, :100])
    grown = among_copies(place, whole, 3_350, where)
    assert grown.map.count == 3_350 and place.map.count == 100
    assert np.array_equal(grown.map.parameters[:, :100], whole[:, :100])
    boxes = []
    for first in range(100, 3_350, 500):
        own = grown.map.parameters[:, first : min(first + 500, 3_350)]
        assert np.array_equal(own[3:], whole[3:, : own.shape[1]])
        shift = (own[:3] - whole[:3, : own.shape[1]]).mean(axis=1)
        assert np.allclose(own[:3] - shift[:, None], whole[:3, : own.shape[1]], atol=1e-4)
        assert (abs(shift[2]) < 1e-4) == (where == "floor")
        boxes.append(shift)
    boxes = np.array([np.zeros(3), *boxes])
    apart = np.abs(boxes[:, None] - boxes[None])[~np.eye(len(boxes), dtype=bool)]
    if where == "storeys":
        assert apart[:, 2].min() > STOREY - 1e-3
    else:  # along one of the axes by more than the apartment is long there
        assert ((apart[:, 0] > 6.5) | (apart[:, 1] > 4.5)).all()


def test_a_map_takes_three_arrays_of_fourteen_floats_and_an_identity():
    assert bytes_of(GaussianMap(1024)) == 1024 * (3 * 14 * 4 + 8)


def test_both_kinds_of_copies_are_compared():
    scene, calls = load_scene("box", size=(5.0, 4.0, 2.5)), []
    mapper = Mapper(MapperConfig(iterations=1), np.random.default_rng(0))
    rows = run_copies_benchmark(
        scene, mapper, counts=(20_000,), keyframes=(1, 3), size=(64, 36), probes=2, rounds=2,
        advance=lambda: calls.append(1),
    )  # fmt: skip
    assert [row.where for row in rows] == ["storeys", "floor"] and len(calls) == 2
    for row in rows:
        assert row.gaussians[1] == 20_000 > row.gaussians[0] > 0 and row.pairs == 4
        assert 0 < row.event_ratio[0] <= row.event_ratio[1] <= row.event_ratio[2] and row.mb_per_million == 176.0
