"""Finished runs that were never run: what the report needs, with numbers chosen by the test."""

from pathlib import Path

import numpy as np
import pytest

from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, scene_label
from activestructure_gym.evaluation.archive.store import Run


@pytest.fixture
def make_run(tmp_path):
    return maker(tmp_path)


@pytest.fixture(scope="module")
def make_module_run(tmp_path_factory):
    """The same for what is written once for a file of tests."""
    return maker(tmp_path_factory.mktemp("runs"))


def maker(place: Path):
    """What makes a run whose directory would be in ``place``."""

    def make(
        scene: str = "room",
        policy: str = "random",
        seed: int = 0,
        seconds: float = 10.0,
        planes: bool = False,
        swept: dict | None = None,
        **numbers,
    ) -> Run:
        job = Job(scene, policy, seed, "", Conditions(overrides=swept or {}), tuple(swept or ()))
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
            "configuration": {"frame_budget": 100, "sensor": {"width": 96, "height": 54, "depth_noise": "none"}},
            "versions": dict.fromkeys(("activestructure-gym", "python", "numpy", "numba"), "1.0"),
        }
        stages = {"planning": 1.0, "features": 2.0, "policy": 0.5, "mapping": 4.0, "sensor": 1.5}
        hardware = {"processor": "none", "cores": 2}
        timing = {"total": seconds, "seconds": stages, "decisions": [2.0, 4.0, 6.0], "hardware": hardware}
        directory = Path(place) / "jobs" / job.name
        results = {"metrics": metrics, "curve": curve}
        run = Run(directory, scene_label(scene), job, config, results, timing)
        run.__dict__["pictures"] = _pictures(seed)
        run.__dict__["trajectory"] = _trajectory(seed)
        run.__dict__["graph"] = _graph() if planes else None
        run.__dict__["steps"] = _steps()
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


@pytest.fixture
def wall_and_floor() -> dict[str, np.ndarray]:
    """The arrays of a graph made by hand, metres: a floor of 4 x 3 that is structural and good, and an object plane
    that stands on it at y = 1.5, 2 long and 1 high, faces south and lacks a lot. One edge, which is the tree's, and
    one hole in the floor."""
    return _graph()


def _graph() -> dict[str, np.ndarray]:
    floor, wall = np.ones((40, 30), np.uint8), np.ones((20, 10), np.uint8)
    floor[30:33, 3:6] = 0
    bits = [np.packbits(floor), np.packbits(wall)]
    return {
        "ids": np.array([0, 3]),
        "normals": np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        "offsets": np.array([0.0, 1.5]),
        "centroids": np.array([[2.0, 1.5, 0.0], [2.0, 1.5, 0.5]]),
        "areas": np.array([11.91, 2.0]),
        "structural": np.array([True, False]),
        "deficit": np.array([0.0, 0.05]),
        "edges": np.array([[0, 1]]),
        "edge_weights": np.array([0.4]),
        "edge_in_tree": np.array([True]),
        "deficiency_centres": np.array([[3.15, 0.45, 0.0]]),
        "deficiency_normals": np.array([[0.0, 0.0, 1.0]]),
        "deficiency_areas": np.array([0.09]),
        "deficiency_planes": np.array([0]),
        "cell": np.array(0.1),
        "patch_corners": np.array([[0.0, 0.0, 0.0], [1.0, 1.5, 0.0]]),
        "patch_axes": np.array([[[1.0, 0, 0], [0, 1.0, 0]], [[1.0, 0, 0], [0, 0, 1.0]]]),
        "patch_shapes": np.array([[40, 30], [20, 10]]),
        "patch_starts": np.array([0, len(bits[0]), len(bits[0]) + len(bits[1])]),
        "patch_bits": np.concatenate(bits),
    }


@pytest.fixture
def no_planes() -> dict[str, np.ndarray]:
    """The arrays of a graph without planes."""
    from activestructure_gym.planes import PlaneSceneGraph
    from activestructure_gym.planes.record import graph_arrays

    return graph_arrays(PlaneSceneGraph())


def _steps() -> list[dict]:
    graph = {"structural": 3, "objects": 2, "deficiency_centres": 4, "deficiency_area": 0.5}
    numbers = {f"{what}{kind}": 0.3 for what in ("deficit", "quality") for kind in ("", "_structural", "_objects")}
    return [
        {"frames": 10 * (k + 1), "graph": graph | numbers, "trace": {"pixel": 0.5 / (k + 1), "travel": 0.4}}
        for k in range(6)
    ]


@pytest.fixture
def steps() -> list[dict]:
    """Six decisions of ten frames each, by a policy without phases."""
    return _steps()
