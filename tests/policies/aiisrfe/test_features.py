"""Frontiers by hand, the view that serves each, and the colour error of voxels."""

from __future__ import annotations

import numpy as np
import pytest

from activestructure_gym.features import evaluate_features
from activestructure_gym.features.voxel_errors import voxel_colour_errors
from activestructure_gym.policies.aiisrfe.features import frontiers
from activestructure_gym.volume import FREE, UNKNOWN


def free_cross(two_walls) -> None:
    """A corridor of 0.6 x 0.6 m, known to be free, from x = -1.5 m to x = 1.5 m; nothing else is known."""
    two_walls.know(UNKNOWN)
    volume = two_walls.volume
    x, y, z = (volume.origin[i] + (np.arange(volume.shape[i]) + 0.5) * volume.config.voxel_size for i in range(3))
    inside = np.ix_(np.abs(x) < 1.5, np.abs(y) < 0.3, np.abs(z) < 0.3)
    volume.state[inside] = FREE
    volume.weight[inside] = 1


def test_a_frontier_is_free_space_beside_the_unseen_cut_into_cubes(two_walls) -> None:
    free_cross(two_walls)
    voxels, cluster = frontiers(two_walls.context())
    volume = two_walls.volume
    state = volume.state[tuple(volume.voxel_of(voxels).T)]
    assert (state == FREE).all() and len(voxels) == 30 * 6 * 6 - 28 * 4 * 4  # the hull of the corridor
    cubes = np.floor((voxels - volume.origin) / 2.0)
    for c in range(cluster.max() + 1):
        assert len(np.unique(cubes[cluster == c], axis=0)) == 1 and (cluster == c).sum() >= 50
    two_walls.know(FREE)
    assert len(frontiers(two_walls.context())[0]) == 0


@pytest.mark.parametrize(("side", "found"), [(3, 0), (4, 56)])  # 27 voxels, and 64 of which 56 are at the surface
def test_a_frontier_of_few_voxels_is_none(two_walls, side: int, found: int) -> None:
    two_walls.know(UNKNOWN)
    two_walls.volume.state[2 : 2 + side, 2 : 2 + side, 2 : 2 + side] = FREE
    two_walls.volume.weight[2 : 2 + side, 2 : 2 + side, 2 : 2 + side] = 1
    assert len(frontiers(two_walls.context())[0]) == found


def test_every_frontier_in_sight_has_the_view_that_sees_most_of_it(two_walls, looks) -> None:
    free_cross(two_walls)
    # East sees (0, 76, 136) voxels of the three frontiers, west (96, 116, 0), north (0, 4, 0).
    table = evaluate_features(("aiisrfe",), two_walls.context(*looks, revisit=np.zeros(3, bool)))
    assert table[:, 0].tolist() == [2, 0, -1]  # west, which also sees most of the second, serves the first
    alone = evaluate_features(("aiisrfe",), two_walls.context(looks[2], revisit=np.zeros(1, bool)))
    assert alone[0, 0] == -1  # 4 voxels are too few
    two_walls.know(FREE)
    table = evaluate_features(("aiisrfe",), two_walls.context(*looks))
    assert (table[:, 0] == -1).all()


def test_a_frontier_that_a_revisit_sees_best_is_anothers(two_walls, looks) -> None:
    free_cross(two_walls)
    east = looks[0]
    again = evaluate_features(("aiisrfe",), two_walls.context(east, east, revisit=np.array([True, False])))
    assert again[0, 0] == -1 and again[1, 0] >= 0
    alone = evaluate_features(("aiisrfe",), two_walls.context(east, revisit=np.array([True])))
    assert alone[0, 0] == -1


def test_the_error_of_a_voxel_is_that_of_the_pixels_in_it(two_walls, looks) -> None:
    mapper, volume = two_walls.mapper, two_walls.volume
    before = voxel_colour_errors(mapper, volume)
    frame = mapper.keyframes[-1]  # the west wall
    color = mapper.render(frame.camera, frame.world_from_camera).color
    pose = frame.world_from_camera
    points = frame.camera.backproject(frame.depth) @ pose[:3, :3].T + pose[:3, 3]
    error = ((color - frame.rgb / 255.0) ** 2).mean(axis=-1)
    at = volume.voxel_of(points.reshape(-1, 3).astype(float))
    here = tuple(at[5])
    pixels = (at == at[5]).all(axis=1)
    assert before[here] == pytest.approx(error.ravel()[pixels].mean(), rel=1e-4) and before[here] > 0
    # The map forgets the west's colours: there, and only there, views are less sure.
    first = evaluate_features(("aiisrfe",), two_walls.context(*looks))[:, 1]
    west = mapper.map.means[:, 0] < 0
    mapper.map.parameters[11:, : mapper.map.count][:, west] = 0.0
    second = evaluate_features(("aiisrfe",), two_walls.context(*looks))[:, 1]
    assert second[1] > 2 * first[1] and second[0] == pytest.approx(first[0]) and second[2] == 0.0
