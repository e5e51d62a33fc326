"""A map is trained from scratch on the keyframes of a run, equally for every run."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import Conditions, compare
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.protocols import (
    PROTOCOLS,
    CameraPath,
    OfflineProtocol,
    StandardProtocol,
    Truth,
    protocol_from,
)
from activestructure_gym.evaluation.protocols.offline import shuffled
from activestructure_gym.geometry import PinholeCamera
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.mapping import GaussianMap, Mapper
from activestructure_gym.scenes import load_scene

FEW: dict[str, Any] = {"views": 2, "view_width": 64, "view_height": 36, "surface_samples": 2000, "tsdf_voxel_m": 0.06}
SMALL = OfflineProtocol(iterations=20, image_width=48, image_supersample=2, **FEW)


@pytest.fixture(scope="module")
def truth() -> Truth:
    return SMALL.truth(ground_truth_of(load_scene("box")))


def path_of(count: int, max_range: float = 10.0) -> CameraPath:
    poses = ground_truth_of(load_scene("box")).free_space.start_poses
    return CameraPath(PinholeCamera.from_size(16, 9), poses[0], poses[:count], max_range)


@pytest.fixture(scope="module")
def measured(truth: Truth) -> dict[str, Any]:
    return SMALL.evaluate(GaussianMap(), truth, path_of(4))


def test_the_numbers_depend_on_the_keyframes_alone(measured: dict[str, Any], truth: Truth) -> None:
    finished = dataclasses.replace(SMALL, iterations=0).trained(truth.scene, path_of(1)).map  # any other map
    assert SMALL.evaluate(finished, truth, path_of(4)) == measured
    assert measured["keyframes"] == 4 and measured["gaussians"] > 1000
    one = SMALL.evaluate(finished, truth, path_of(1))
    assert one["psnr"] < measured["psnr"] and one["completion_ratio"] < measured["completion_ratio"]


def test_the_trained_map_is_measured_as_standard_measures(measured: dict[str, Any], truth: Truth) -> None:
    gaussians = SMALL.trained(truth.scene, path_of(4)).map
    standard = StandardProtocol(**FEW).evaluate(gaussians, truth, path_of(4))
    assert {name: measured[name] for name in standard} == standard


def test_training_brings_the_map_closer_to_the_keyframes(truth: Truth) -> None:
    found = []
    for iterations in (0, 20):
        mapper = dataclasses.replace(SMALL, iterations=iterations).trained(truth.scene, path_of(4))
        assert isinstance(mapper, Mapper)
        found.append(mapper.keyframe_psnr(renders=None).mean())
    assert found[1] > found[0] + 0.5, found


def test_steps_are_equal_for_any_number_of_keyframes() -> None:
    order = shuffled(7, 20, seed=0)
    assert len(order) == len(shuffled(50, 20, seed=0)) == 20
    assert sorted(order[:7]) == sorted(order[7:14]) == list(range(7)) and order[:7] != order[7:14]
    assert shuffled(0, 20, seed=0) == []


def test_keyframes_end_at_the_range_of_the_sensor(truth: Truth) -> None:
    path = path_of(1, max_range=2.5)
    means = dataclasses.replace(SMALL, iterations=0).trained(truth.scene, path).map.means
    depth = (means - path.start[:3, 3]) @ path.start[:3, 2]
    assert 0 < len(means) and depth.max() < 2.55


def test_without_keyframes_the_map_is_empty(truth: Truth) -> None:
    found = SMALL.evaluate(GaussianMap(), truth, path_of(0))
    assert (found["keyframes"], found["gaussians"], found["completion_ratio"]) == (0, 0, 0.0)


def test_a_map_without_poses_cannot_be_trained_again(truth: Truth) -> None:
    with pytest.raises(InputError, match=r"'offline' trains on the keyframes of a run.*give --poses"):
        SMALL.evaluate(GaussianMap(), truth)
    with pytest.raises(InputError, match="the scene to draw them"):
        SMALL.evaluate(GaussianMap(), dataclasses.replace(truth, scene=None), path_of(1))


def test_its_constants_are_recorded_and_it_measures_no_run_alone() -> None:
    assert protocol_from(json.loads(json.dumps(SMALL.parameters()))) == SMALL
    # A map that `standard` would measure differently gets other numbers here too.
    assert (StandardProtocol.version, OfflineProtocol.version) == (5, 1)
    with pytest.raises(InputError, match="first protocol of a run must be 'standard', got 'offline'"):
        Conditions(protocol=SMALL)


@dataclasses.dataclass(frozen=True)
class SmallOffline(OfflineProtocol):
    iterations: int = 20
    image_width: int = 48
    image_supersample: int = 1
    views: int = 2
    surface_samples: int = 2000
    tsdf_voxel_m: float = 0.06


def test_a_run_is_measured_by_it_and_again_with_equal_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(PROTOCOLS._entries, "offline", SmallOffline)
    conditions = Conditions(
        preset="fast", frame_budget=10, protocol=StandardProtocol(**FEW), also=("offline",)
    )  # fmt: skip
    (run,) = compare(["box"], ["random"], tmp_path / "out", conditions=conditions, engine="inline").runs
    found = run.protocols["offline"]
    assert found["parameters"]["iterations"] == 20
    assert found["metrics"]["keyframes"] == run.metrics["metrics"]["keyframes"]
    assert np.isfinite(found["metrics"]["psnr"])
    assert main(["evaluate", str(run.directory)]) == 0
    assert "every stored number is identical" in capsys.readouterr().out
    copy = Path(shutil.copytree(run.directory, tmp_path / "copy"))
    shutil.rmtree(copy / store.EVALUATIONS)
    assert main(["evaluate", str(copy), "--protocols", "offline"]) == 0
    assert store.read_run(copy).protocols["offline"] == found
