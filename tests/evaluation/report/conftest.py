"""Finished runs that were never run: what the report needs, with numbers chosen by the test."""

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.evaluation.jobs import Job, scene_label
from activestructure_gym.evaluation.store import Run


@pytest.fixture
def make_run(tmp_path):
    def make(scene: str = "room", policy: str = "random", seed: int = 0, seconds: float = 10.0, **numbers) -> Run:
        job = Job(scene, policy, seed)
        metrics = {
            "accuracy_cm": 1.0, "completion_cm": 5.0, "completion_ratio": 80.0, "precision": 99.0, "psnr": 20.0,
            "ssim": 0.7, "frames": 100, "metres": 12.0, "collisions": 0, "true_area_m2": 60.0,
            "true_samples": 30000, "views": [{"psnr": 20.0}],
        }  # fmt: skip
        metrics |= numbers
        final, cost = metrics["completion_ratio"], metrics["metres"]
        curve = [
            {"decision": i, "frames": 1 + i * 33, "metres": cost * i / 3, "completion_ratio": final * (i + 1) / 4,
             "psnr": 10.0 + i + seed}
            for i in range(4)
        ]  # fmt: skip
        config = {
            "scene": {"extent_m": [5.0, 4.0, 2.5], "triangles": 1234, "source": "a test", "notes": ["made up"]},
            "configuration": {"sensor": {"width": 96, "height": 54, "depth_noise": "none"}},
            "versions": dict.fromkeys(("activestructure-gym", "python", "numpy", "numba", "embreex"), "1.0"),
        }
        timing = {"total": seconds, "hardware": {"processor": "none", "cores": 2}}
        directory = Path(tmp_path) / "jobs" / job.name
        results = {"metrics": metrics, "curve": curve, "curve_views": 8}
        run = Run(directory, scene_label(scene), job, config, results, timing)
        run.__dict__["pictures"] = _pictures(seed)
        run.__dict__["trajectory"] = _trajectory(seed)
        return run

    return make


def _pictures(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    state = np.zeros((50, 40), np.uint8)
    state[5:45, 5:35] = 1
    state[20:24, 10:30] = 2
    return {
        "rendered": rng.integers(0, 256, (4, 54, 96, 3), dtype=np.uint8),
        "true": rng.integers(0, 256, (4, 54, 96, 3), dtype=np.uint8),
        "psnr": np.array([20.0, 21.0, 22.0, 23.0]),
        "plan_state": state,
        "plan_corner": np.array([0.0, 0.0]),
        "plan_extent": np.array([5.0, 4.0]),
        "above_rgb": np.full((360, 450, 3), 200, np.uint8),
        "above_alpha": np.zeros((360, 450), np.uint8),
    }


def _trajectory(seed: int) -> dict[str, np.ndarray]:
    poses = np.tile(np.eye(4), (20, 1, 1))
    # Looking along x: the camera's z axis.
    poses[:, :3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    poses[:, 0, 3] = np.linspace(1.0, 4.0, 20)
    poses[:, 1, 3] = 1.0 + 0.1 * seed
    return {"world_from_camera": poses, "keyframes": np.arange(0, 20, 5)}
