"""Presets, overrides, and what is refused."""

from __future__ import annotations

import copy
import dataclasses
import json

import pytest

from activestructure_gym.config import PRESETS, ReconstructionConfig, configure
from activestructure_gym.errors import InputError
from activestructure_gym.mapping import MAPPERS


def test_presets_differ_from_the_default_only_where_they_say_so() -> None:
    assert configure() == configure("default") == ReconstructionConfig()
    for name in PRESETS:
        assert isinstance(configure(name), ReconstructionConfig)
    assert configure("fast").sensor.width == 96
    less, fast = configure("rl"), configure("fast")
    assert not less.mapper.enabled and not less.planes.enabled
    assert configure("rl", {"mapper.enabled": True, "planes.enabled": True}) == fast
    # The paper's sensor: 60 x 90 degrees at f = 600, 2000 frames.
    paper = configure("paper")
    camera = paper.sensor.camera
    assert (camera.width, camera.height, paper.frame_budget) == (1200, 680, 2000)
    assert camera.fx == pytest.approx(600)


@pytest.mark.parametrize(
    ("clearance", "voxel", "fits"), [(0.2, 0.1, True), (0.2, 0.5, False), (0.3, 0.5, True), (0.04, 0.1, False)]
)
def test_paths_keep_away_by_more_than_their_samples_may_overlook(clearance: float, voxel: float, fits: bool) -> None:
    """Half a voxel's samples of a field of slope sqrt 3 lose .433 voxels: with less nothing would ever block a path."""
    changes = {"motion.min_clearance": clearance, "volume.voxel_size": voxel}
    if fits:
        assert configure("default", changes).volume.voxel_size == voxel
    else:
        with pytest.raises(InputError, match="min_clearance must be above .* of volume.voxel_size"):
            configure("default", changes)


def test_keyframes_are_reduced_by_a_common_divisor() -> None:
    paper = configure("paper")
    assert (paper.sensor.width / paper.mapper.keyframe_reduction, paper.mapper.keyframe_reduction) == (300, 4)
    with pytest.raises(InputError, match="keyframe_reduction must divide the sensor's 1200 x 680 pixels, got 3"):
        configure("paper", {"mapper.keyframe_reduction": 3})


def test_nested_and_dotted_overrides_agree_and_leave_the_rest() -> None:
    nested = configure("fast", {"sensor": {"depth_noise": "kinect", "width": 64}})
    dotted = configure("fast", {"sensor.depth_noise": "kinect", "sensor.width": 64})
    mixed = configure("fast", {"sensor.depth_noise": "kinect", "sensor": {"width": 64}})
    assert nested == dotted == mixed
    assert nested.sensor == dataclasses.replace(configure("fast").sensor, depth_noise="kinect", width=64)
    assert configure("default", {"features": ["pixel", "hole_area"]}).features == ("pixel", "hole_area")


def test_mixed_overrides_keep_each_others_fields_and_leave_the_callers_alone() -> None:
    one = {"planes.detection.max_depth": 5.0, "planes": {"detection": {"min_block": 4}}}
    other = {"planes": {"detection": {"min_block": 4}}, "planes.detection.max_depth": 5.0}
    before = copy.deepcopy(other)
    first, second = (configure("fast", overrides).planes.detection for overrides in (one, other))
    assert first == second and (first.max_depth, first.min_block) == (5.0, 4)
    assert other == before


def test_a_mapper_is_chosen_by_name_and_its_fields_replaced() -> None:
    nested = configure("fast", {"mapper": {"name": "splatam", "window": 5}})
    dotted = configure("fast", {"mapper.window": 5, "mapper.name": "splatam"})
    expected = dataclasses.replace(MAPPERS.get("splatam"), window=5, **PRESETS["fast"]["mapper"])
    assert nested.mapper == dotted.mapper == expected
    assert configure("default", {"mapper.name": "splatam"}).mapper == MAPPERS.get("splatam")
    assert configure("default", {"mapper.name": "default"}) == configure()


@pytest.mark.parametrize("name", list(MAPPERS))
def test_a_recorded_configuration_makes_the_same_one_again(name: str) -> None:
    config = configure("fast", {"mapper.name": name, "mapper.tracking.iterations": 3})
    recorded = json.loads(json.dumps(dataclasses.asdict(config), allow_nan=False))
    assert configure("default", recorded) == config


@pytest.mark.parametrize(
    ("preset", "overrides", "message"),
    [
        ("fats", {}, "unknown preset 'fats'; did you mean 'fast'"),
        ("fast", {"frame_buget": 3}, "'frame_buget' of ReconstructionConfig; did you mean 'frame_budget'"),
        ("fast", {"sensor.depth_nois": "x"}, "unknown field 'depth_nois' of SensorConfig"),
        ("fast", {"frame_budget": 0}, "the frame budget must be at least 1, got 0"),
        ("fast", {"keyframe_every": 0}, "keyframe_every must be a whole number from 1 to 1000000, got 0"),
        ("fast", {"features": ("pixl",)}, "unknown feature 'pixl'; did you mean 'pixel'"),
        ("fast", {"views.directions": 0}, "directions"),
        ("fast", {"sensor.width": 0}, "width"),
        ("fast", {"frame_budget": "many"}, "frame_budget must be a whole number, got 'many'"),
        ("fast", {"mapper.iterations": 2.5}, "MapperConfig.iterations must be a whole number, got 2.5"),
        ("fast", {"sensor.max_range": True}, "SensorConfig.max_range must be a finite number, got True"),
        ("fast", {"mapper.name": "splatm"}, "unknown mapper 'splatm'; did you mean 'splatam'"),
        ("fast", {"mapper.name": 3}, "a mapper is given by its name, as a text, got 3"),
        ("fast", {"mapper.trackin": 3}, "unknown field 'trackin' of MapperConfig; did you mean 'tracking'"),
        ("fast", {"sensor": 3}, "sensor must be a group of fields, got 3"),
        ("fast", {"motion": None}, "motion must be a group of fields, got None"),
        ("fast", {"frame_budget": 1, "frame_budget.x.y": 1}, "sets a field of frame_budget, which is also set"),
        ("fast", {"sensor": 3, "sensor.width": 96}, "sets a field of sensor, which is also set as a whole"),
        ("fast", {"features": "pixel"}, "features must be a list, got 'pixel'"),
    ],
)
def test_a_bad_configuration_gets_one_clear_sentence(preset: str, overrides: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        configure(preset, overrides)
