"""Environments whose map is drawn by another backend than the kernels."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from activestructure_gym import Reconstruction, configure, ground_truth_of, load_scene
from activestructure_gym.envs import ENV_IDS  # noqa: F401  (registers them)
from activestructure_gym.errors import InputError
from activestructure_gym.splatting import backend_status

# Few enough pixels and Gaussians for every pixel to be compared with every Gaussian.
TINY = {
    "sensor": {"width": 32, "height": 18},
    "views": {"max_candidates": 16},
    "mapper": {"seed_spacing": 0.2, "seed_pixels": 3.0, "iterations": 2},
}


def test_gains_of_the_same_map_agree() -> None:
    # Not optimised: a step of Adam's makes of a rounding as much as of a gradient (tests/mapping/test_backends.py).
    features = []
    for backend in ("cpu", "reference"):
        names = {"features": ["pixel", "hole_area", "gauss_mi_cov", "fisherrf_cov", "activeinr"]}
        overrides = {**TINY, **names, "mapper.backend": backend, "mapper.iterations": 0, "frame_budget": 30}
        episode = Reconstruction(configure("fast", overrides))
        episode.start(ground_truth_of(load_scene("box")), seed=0)
        episode.move_to(0)
        features.append(episode.features)
    kernels, reference = features
    assert kernels.shape == reference.shape and (np.ptp(kernels[:, :2], axis=0) > 0.05).all()
    pixels = 16 * 9
    assert np.abs(kernels[:, 0] - reference[:, 0]).max() <= 1.5 / pixels  # a pixel at the limit may fall on either side
    assert np.abs(kernels[:, 1] - reference[:, 1]).max() <= 1e-5


@pytest.mark.slow
def test_an_environment_by_the_reference_passes_the_checker() -> None:
    env = gym.make(
        "ActiveStructure/Room-v0", preset="fast", frame_budget=60, disable_env_checker=True,
        config={**TINY, "mapper.backend": "reference"},
    )  # fmt: skip
    check_env(env.unwrapped, skip_render_check=True)


def test_a_backend_that_cannot_run_is_refused_when_the_environment_is_made() -> None:
    status = backend_status()["gsplat"]
    if status == "works":
        pytest.skip("gsplat can run here")
    with pytest.raises(InputError, match="'gsplat' cannot run here") as caught:
        Reconstruction(configure("fast", {"mapper.backend": "gsplat"}))
    assert status in str(caught.value)
