"""The map keeps Gaussians and moments together, and comes back from its file as it was."""

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.mapping import GaussianMap
from activestructure_gym.mapping.boxes import block_boxes
from activestructure_gym.mapping.gaussian_map import ROWS


def _filled(count, seed=0):
    rng = np.random.default_rng(seed)
    gaussians = GaussianMap(16)
    gaussians.append(rng.normal(size=(14, count)).astype(np.float32))
    gaussians.first_moment[:, :count] = rng.normal(size=(14, count))
    gaussians.second_moment[:, :count] = rng.random((14, count))
    return gaussians


def _live(gaussians):
    return [
        array[:, : gaussians.count].copy()
        for array in (gaussians.parameters, gaussians.first_moment, gaussians.second_moment)
    ]


def test_moments_survive_insertions():
    gaussians = _filled(30)
    before = _live(gaussians)
    block = np.full((14, 50), 7, dtype=np.float32)
    gaussians.append(block)  # 80 > 48: the arrays grow
    assert gaussians.count == 80 and gaussians.capacity % 16 == 0
    for array, old, new in zip(_live(gaussians), before, (7, 0, 0)):
        assert np.array_equal(array[:, :30], old)
        assert (array[:, 30:] == new).all()


def test_moments_survive_removals_and_new_ones_start_at_zero():
    gaussians = _filled(30)
    before = _live(gaussians)
    mask = np.arange(30) % 3 != 1
    assert gaussians.keep(mask) == 10
    # The last survivors fill the gaps: of 0 .. 19 the multiples of 3 plus 1 went, of 20 .. 29 these stay.
    order = np.arange(20)
    order[1::3] = [20, 21, 23, 24, 26, 27, 29]
    assert all(np.array_equal(array, old[:, order]) for array, old in zip(_live(gaussians), before))
    # The columns behind hold what was removed; a new Gaussian must not inherit its moments.
    gaussians.append(np.ones((14, 5), np.float32))
    assert (gaussians.first_moment[:, 20:25] == 0).all() and (gaussians.second_moment[:, 20:25] == 0).all()


def test_a_removal_moves_no_more_columns_than_it_removes():
    rng = np.random.default_rng(3)
    gaussians = _filled(1000)
    before = _live(gaussians)[0]
    mask = np.ones(1000, dtype=bool)
    mask[rng.choice(1000, 40, replace=False)] = False
    gaussians.keep(mask)
    moved = (gaussians.parameters[:, :960] != before[:, :960]).any(axis=0)
    assert 0 < moved.sum() <= 40 and not mask[:960][moved].any()
    assert {column.tobytes() for column in gaussians.parameters[:, :960].T} == {
        column.tobytes() for column in before[:, mask].T
    }


@pytest.mark.parametrize("kept", [0, 30])
def test_removing_all_or_none(kept):
    gaussians = _filled(30)
    before = _live(gaussians)
    assert gaussians.keep(np.full(30, kept > 0)) == 30 - kept
    assert gaussians.count == kept
    assert all(np.array_equal(array, old[:, :kept]) for array, old in zip(_live(gaussians), before))


def test_growth_is_geometric():
    gaussians = GaussianMap(16)
    capacities = set()
    for _ in range(2000):
        gaussians.append(np.zeros((14, 1), np.float32))
        capacities.add(gaussians.capacity)
    assert len(capacities) < 20 and gaussians.capacity < 1.6 * 2000


def test_activated_values_of_one_gaussian():
    gaussians = GaussianMap()
    gaussians.append(np.array([[1, 2, 3, 2, 0, 0, 0, 0, np.log(0.5), -np.inf, 0, 0.1, 0.2, 0.3]], np.float32).T)
    assert gaussians.means.tolist() == [[1, 2, 3]]
    assert gaussians.quaternions.tolist() == [[1, 0, 0, 0]]  # normalised
    assert gaussians.scales == pytest.approx(np.array([[1, 0.5, 0]]))
    assert gaussians.opacities.tolist() == [0.5]
    assert gaussians.colors == pytest.approx(np.array([[0.1, 0.2, 0.3]]))


@pytest.mark.parametrize("block", [np.zeros((13, 4)), np.zeros(14)])
def test_blocks_of_another_shape_are_refused(block):
    with pytest.raises(ValueError, match=r"\(14, n\)"):
        GaussianMap().append(block)


@pytest.mark.parametrize("mask", [np.ones(3, int), np.ones(4, bool)])
def test_masks_of_another_kind_are_refused(mask):
    with pytest.raises(ValueError, match="mask must be bool"):
        _filled(3).keep(mask)


@pytest.mark.parametrize("count", [0, 33])
def test_npz_round_trip(tmp_path, count):
    gaussians = _filled(count)
    gaussians.save_npz(tmp_path / "map.npz")
    loaded = GaussianMap.load_npz(tmp_path / "map.npz")
    assert loaded.count == count
    assert all(np.array_equal(a, b) for a, b in zip(_live(loaded), _live(gaussians)))
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]  # nothing temporary left


def _damage_version(path):
    np.savez(path, format_version=np.int64(99), parameters=np.zeros((14, 1), np.float32))


def _damage_shape(path):
    arrays = dict.fromkeys(("parameters", "first_moment", "second_moment"), np.zeros((13, 1), np.float32))
    np.savez(path, format_version=np.int64(1), **arrays)


def _damage_pickle(path):
    np.savez(path, format_version=np.int64(1), parameters=np.array([{}], dtype=object))


def _damage_bytes(path):
    path.write_bytes(b"PK\x03\x04 no archive")


def _damage_empty(path):
    path.write_bytes(b"")


def _damage_archive(path):
    with open(path, "wb") as file:
        np.save(file, np.zeros((14, 1), np.float32))


def _damage_type(path):
    arrays = dict.fromkeys(("parameters", "first_moment", "second_moment"), np.full((14, 1), "x"))
    np.savez(path, format_version=np.int64(1), **arrays)


def _damage_range(path):
    arrays = dict.fromkeys(("parameters", "first_moment", "second_moment"), np.full((14, 1), 1e300))
    np.savez(path, format_version=np.int64(1), **arrays)


def _damage_version_type(path):
    np.savez(path, format_version=np.array("one"), parameters=np.zeros((14, 1), np.float32))


@pytest.mark.parametrize(
    "damage",
    [
        _damage_version, _damage_version_type, _damage_shape, _damage_type, _damage_range, _damage_pickle,
        _damage_archive, _damage_bytes, _damage_empty, lambda path: None,
    ],
)  # fmt: skip
def test_files_that_are_no_maps_are_refused(tmp_path, damage):
    damage(tmp_path / "map.npz")
    with pytest.raises(InputError, match=r"map\.npz"):
        GaussianMap.load_npz(tmp_path / "map.npz")


def test_rows_begin_on_cache_lines_however_often_the_map_grows():
    grown = GaussianMap(capacity=5)
    for count in (3, 40, 1000):
        grown.append(np.ones((14, count), np.float32))
        for array in (grown.parameters, grown.first_moment, grown.second_moment):
            assert array.ctypes.data % 64 == 0 and array.strides == (4 * grown.capacity, 4)
            assert grown.capacity % 16 == 0


def test_reset_moments_forgets_the_moments_and_nothing_else():
    held = GaussianMap()
    held.append(np.full((14, 5), 2.0, np.float32))
    held.first_moment[:, :5] = 3.0
    held.second_moment[:, :5] = 4.0
    held.reset_moments()
    assert not held.first_moment[:, :5].any() and not held.second_moment[:, :5].any()
    assert (held.parameters[:, :5] == 2.0).all()


def test_reordering_moves_whole_gaussians_with_moments_ids_and_boxes():
    rng = np.random.default_rng(0)
    gaussians = GaussianMap()
    gaussians.append(rng.standard_normal((ROWS, 3000)).astype(np.float32))
    gaussians.first_moment[:, :3000] = rng.standard_normal((ROWS, 3000))
    gaussians.boxes()
    before = gaussians.parameters[:, :3000].copy(), gaussians.first_moment[:, :3000].copy()
    order = rng.permutation(3000)
    gaussians.reorder(order)
    np.testing.assert_array_equal(gaussians.ids[:3000], order)  # they were numbered by their place
    np.testing.assert_array_equal(gaussians.parameters[:, :3000], before[0][:, order])
    np.testing.assert_array_equal(gaussians.first_moment[:, :3000], before[1][:, order])
    np.testing.assert_array_equal(gaussians.boxes(), block_boxes(gaussians.parameters, 3000))


@pytest.mark.parametrize("order", [np.arange(4), np.array([0, 0, 2]), np.array([0.0, 1.5, 2.0])])
def test_orders_that_lose_gaussians_are_refused(order):
    gaussians = GaussianMap()
    gaussians.append(np.zeros((ROWS, 3), np.float32))
    with pytest.raises(ValueError, match="each index from 0 to 2 once"):
        gaussians.reorder(order)


@pytest.mark.parametrize("columns", [[-1], [3], [1, 1], [2, 0]])
def test_columns_that_are_not_there_or_do_not_rise_are_refused(columns):
    gaussians = GaussianMap()
    gaussians.append(np.zeros((ROWS, 3), np.float32))
    with pytest.raises(ValueError, match="rise within 0..2"):
        gaussians.remove(np.array(columns))
