"""ActiveGAMER's exploration map: what a depth image decides about a voxel is permanent."""

from __future__ import annotations

import numpy as np

from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.geometry.frame import Frame
from activestructure_gym.sources.once_free import FOUND_FREE, FOUND_NEAR, FOUND_SURFACE, UNTESTED, decide_voxels
from activestructure_gym.volume import VoxelVolume


def seen(place: tuple[float, float, float], along: tuple[float, float, float], depth: float) -> Frame:
    """Return an image of 90 x 90 degrees of a wall ``depth`` metres ahead."""
    pose = look_along(np.array(place), np.array(along))
    return Frame(np.zeros((8, 8, 3), np.uint8), np.full((8, 8), depth, np.float32), pose, PinholeCamera.from_size(8, 8))


def test_voxels_are_decided_by_the_first_image_that_tests_them() -> None:
    volume = VoxelVolume(np.array([[-0.05, -3.05, -3.05], [4.05, 3.05, 3.05]]))
    state = np.full(volume.shape, UNTESTED, np.uint8)

    def at(*place: float) -> int:
        return int(state[tuple(volume.voxel_of(np.array(place)))])

    # A wall 3 m ahead, looking along x: it is the image's own surface, so 0.4 m in front of it is free.
    decide_voxels(state, volume, seen((0, 0, 0), (1, 0, 0), 3.0), 0.3)
    assert [at(x, 0, 0) for x in (2.6, 2.8, 3.0, 3.2)] == [FOUND_FREE, UNTESTED, FOUND_SURFACE, UNTESTED]
    assert (
        at(2.0, 0, 1.9) == FOUND_FREE and at(1.7, 0, 1.9) == at(2.0, 0, 2.1) == UNTESTED
    )  # the edge of the image is z = x

    # A ceiling 2.1 m above: the place 0.2 m below it was free and stays so.
    decide_voxels(state, volume, seen((2.0, 0, 0), (0, 0, 1), 2.1), 0.3)
    assert at(2.0, 0, 2.1) == FOUND_SURFACE and at(2.0, 0, 1.9) == FOUND_FREE and at(1.7, 0, 1.9) == UNTESTED

    # Its neighbour, tested later, is 0.2 m from known surface. It is never free afterwards.
    for _ in range(2):
        decide_voxels(state, volume, seen((1.7, -2.0, 1.9), (0, 1, 0), 4.0), 0.3)
        assert at(1.7, 0, 1.9) == FOUND_NEAR and at(1.7, 0, 1.7) == FOUND_FREE


def test_a_pixel_without_a_return_decides_nothing() -> None:
    volume = VoxelVolume(np.array([[-1.0] * 3, [1.0] * 3]))
    state = np.full(volume.shape, UNTESTED, np.uint8)
    decide_voxels(state, volume, seen((0, 0, 0), (1, 0, 0), 0.0), 0.3)
    assert (state == UNTESTED).all()
