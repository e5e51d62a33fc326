"""Choose procedural layouts for training, validation and test; their ranges of seeds are disjoint.

Seeds below 100,000 are left to users and to the published comparisons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from activestructure_gym.errors import InputError
from activestructure_gym.ground_truth.truth import GroundTruth
from activestructure_gym.scenes.library import load_scene

FIRST_SEED = {"validation": 100_000, "test": 200_000, "train": 300_000}
MAX_LAYOUTS = 100_000  # largest number of layouts for one use
_SURFACE_SAMPLES = 12_000  # sample points on a layout's surface: a quarter of the default, for a quarter of the time


@dataclass(frozen=True)
class Layout:
    """Name a scene of which many are used for learning; its surface has 12,000 sample points in place of 50,000.

    The mesh, the free space and the surface are made on first use and kept in the cache directory.
    """

    spec: str  # name for `load_scene`

    def truth(self) -> GroundTruth:
        """Load the scene with its ground truth."""
        return GroundTruth(load_scene(self.spec), _SURFACE_SAMPLES)


def layout_specs(use: str, count: int, rooms: Sequence[int], *, lit: bool = True) -> tuple[str, ...]:
    """Return the names of the first ``count`` layouts for ``use``: "train", "validation" or "test".

    ``rooms`` are numbers of rooms, which consecutive layouts take in turn. Without ``lit``, a layout has the same
    triangles but no light and no textures, and is built 4 to 8 times as fast.
    """
    if not 0 <= count <= MAX_LAYOUTS:
        raise InputError(f"the number of layouts must be from 0 to {MAX_LAYOUTS}, got {count}")
    first, ending = FIRST_SEED[use], "" if lit else "&lit=false"
    return tuple(f"apartment?rooms={rooms[i % len(rooms)]}&seed={first + i}{ending}" for i in range(count))
