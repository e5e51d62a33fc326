"""Short episodes in the box, and random decisions."""

from __future__ import annotations

import numpy as np

from activestructure_gym.config import configure
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.reconstruction import Reconstruction
from activestructure_gym.scenes import Scene

# Keyframes and iterations as in the default preset's schedule, so that a short episode has enough of both.
SMALL = {
    "sensor": {"width": 64, "height": 36}, "views": {"max_candidates": 24},
    "keyframe_every": 5, "mapper.iterations": 2,
}  # fmt: skip


def episode(scene: Scene, seed: int = 0, frames: int = 60, preset: str = "fast", **overrides: object) -> Reconstruction:
    reconstruction = Reconstruction(configure(preset, {**SMALL, "frame_budget": frames, **overrides}))
    reconstruction.start(ground_truth_of(scene), seed)
    return reconstruction


def wander(reconstruction: Reconstruction, seed: int = 0) -> None:
    """Choose random candidates until the budget ends."""
    rng = np.random.default_rng(seed)
    while not reconstruction.exhausted and len(reconstruction.candidates):
        reconstruction.move_to(int(rng.integers(len(reconstruction.candidates))))
