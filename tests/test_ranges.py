"""Every number of every configuration has a range; nothing infinite, no NaN, no nonsense is in any."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from activestructure_gym.config import ReconstructionConfig, configure
from activestructure_gym.envs.reward import RewardConfig
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.protocols import OfflineProtocol, StandardProtocol
from activestructure_gym.evaluation.protocols.activegamer import ActiveGamerProtocol
from activestructure_gym.evaluation.running.engines.base import Limits
from activestructure_gym.evaluation.training.config import TrainingConfig, WorldConfig
from activestructure_gym.ranges import check_ranges


def parts(config):
    yield config
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from parts(value)


CONFIGS = [
    *parts(ReconstructionConfig()), RewardConfig(), *parts(TrainingConfig()), StandardProtocol(), ActiveGamerProtocol(),
    OfflineProtocol(), Limits(),
]  # fmt: skip
NUMBERS = [
    pytest.param(config, field, id=f"{type(config).__name__}.{field.name}")
    for config in CONFIGS
    for field in dataclasses.fields(config)
    if field.type.removeprefix("tuple[").startswith(("int", "float")) and "ClassVar" not in field.type
]


@pytest.mark.parametrize("config, field", NUMBERS)
def test_every_number_of_every_configuration_is_bounded(config, field):
    for value in (math.nan, math.inf, -math.inf, 1e308, -1e308, 2**63 - 1, -(2**63), 10**400, "x", None, True):
        if value is None and "None" in field.type or value == 2**63 - 1 and field.name == "seed":
            continue
        wrong = (value,) if field.type.startswith("tuple") else value
        with pytest.raises(InputError) as caught:
            dataclasses.replace(config, **{field.name: wrong})
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_every_configuration_is_looked_at():
    assert {type(config) for config in CONFIGS} >= {ReconstructionConfig, WorldConfig} and len(NUMBERS) > 150


@pytest.mark.parametrize(
    "overrides, message",
    [
        ({"volume.max_range": math.inf}, "VolumeConfig.max_range must be a finite number, got inf"),
        ({"sensor.max_range": math.nan}, "SensorConfig.max_range must be a finite number, got nan"),
        ({"motion.max_step_m": 1e308}, r"max_step_m must be a number from 0.001 to 100, got 1e\+308"),
        ({"motion.candidate_clearance": -1}, "candidate_clearance must be a number above 0 and at most 100, got -1"),
        ({"views.max_candidates": 9223372036854775807}, "max_candidates must be a whole number from 1 to 65536"),
        ({"views.heights_m": [0.0, 1e9]}, "every entry of heights_m must be a number from -100 to 100"),
        ({"views.heights_m": [0.0] * 1000}, "heights_m must be at most 64 heights, got 1000"),
        ({"views.heights_m": [[1.0]]}, r"every entry of heights_m must be a number from -100 to 100, got \[1.0\]"),
        ({"sensor.width": 10**9}, "sensor width must be a whole number from 1 to 8192"),
        ({"sensor.width": 8192, "sensor.height": 8192}, "must be at most 33554432 rays, got 67108864"),
        ({"mapper.tracking.blurs_deg": []}, "tracking blurs_deg must be a tuple of at least one number"),
        ({"mapper.scene_radius": "wide"}, "scene_radius must be a number above 0 and at most 100000, got 'wide'"),
        ({"mapper.max_gaussians": 10**12}, "max_gaussians must be a whole number from 1 to 10000000"),
        ({"planes.quality.weights_object": [1.0]}, "weights_object must be eight weights"),
    ],
)
def test_the_sentence_says_what_is_allowed(overrides, message):
    with pytest.raises(InputError, match=message):
        configure("fast", overrides)


@dataclasses.dataclass(frozen=True)
class Thing:
    share: float = 0.5
    count: int = 3
    sides: tuple[float, ...] = (1.0, 1.5)
    depth: float | None = None


RANGES = {"share": "(0, 1]", "count": "[1, 10]", "sides": "[0, 2)", "depth": "[-1, 1]"}


@pytest.mark.parametrize(
    "good", [{"share": 1}, {"share": np.float32(0.5)}, {"count": np.int64(10)}, {"sides": (0,)}, {"depth": -1.0}]
)
def test_numbers_of_any_kind_are_taken_up_to_the_ends(good):
    check_ranges(Thing(**good), RANGES)


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"share": 0.0}, "my share must be a number above 0 and at most 1, got 0.0"),
        ({"count": 2.0}, "my count must be a whole number from 1 to 10, got 2.0"),
        ({"sides": (0.0, 2.0)}, "every entry of my sides must be a number from 0 to below 2, got 2.0"),
        ({"sides": ()}, "my sides must be a tuple of at least one number"),
        ({"sides": [1.0]}, "my sides must be a tuple"),
        ({"depth": 2}, "my depth must be a number from -1 to 1, got 2"),
        ({"share": None}, "my share must be a number"),
    ],
)
def test_what_is_outside_is_refused_by_name(wrong, message):
    with pytest.raises(InputError, match=message):
        check_ranges(Thing(**wrong), RANGES, "my ")


def test_a_range_that_cannot_be_read_is_its_author_s_mistake():
    for text in ("[0, inf]", "0, 1", "[1, 0]", "[nan, 1]"):
        with pytest.raises(ValueError):
            check_ranges(Thing(), {"share": text})
