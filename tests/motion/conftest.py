import numpy as np
import pytest

from activestructure_gym.volume import FREE, OCCUPIED, VoxelVolume


@pytest.fixture(scope="session")
def free_volume():
    """Makes a volume known to be free but for the given boxes (lower, upper) in metres."""

    def make(*obstacles, size=(6.0, 4.0, 2.5)):
        volume = VoxelVolume(np.stack([np.zeros(3), size]))
        volume.state[1:-1, 1:-1, 1:-1] = FREE
        centers = volume.center_of(np.stack(np.indices(volume.shape), axis=-1))
        for lower, upper in obstacles:
            volume.state[((centers > lower) & (centers < upper)).all(axis=-1)] = OCCUPIED
        return volume

    return make
