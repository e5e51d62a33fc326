"""Wrong settings are refused by name; what the recipes say about rates."""

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.mapping import MAPPERS, MapperConfig
from activestructure_gym.mapping.registry import mapper_config


@pytest.mark.parametrize(
    "change",
    [
        {"seed_columns": 0},
        {"iterations": -1},
        {"max_gaussians": 0},
        {"seed_opacity": 1.0},
        {"covered_alpha": 1.5},
        {"color_rate": -1e-9},
        {"depth_weight": float("nan")},
        {"scene_radius": 0.0},
        {"seed_spacing": 0.009},
        {"seed_spacing": 1.1},
        {"seed_pixels": 0.4},
        {"border_sigmas": 0.0},
        {"seed_pixels": 0.0},
        {"border_sigmas": -0.1},
        {"texture_contrast": 1.1},
        {"coarse_ratio": float("nan")},
        {"mean_rate": -1e-5},
        {"opacity_rate": float("inf")},
        {"prune_steps": (0, -2)},
        {"prune_steps": (1.5,)},
    ],
)
def test_wrong_values_are_refused_by_name(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        MapperConfig(**change)


def test_a_rate_stands_in_every_row_of_its_parameter():
    config = MapperConfig(mean_rate=1.0, quaternion_rate=2.0, log_scale_rate=3.0, opacity_rate=4.0, color_rate=5.0)
    assert config.learning_rates().tolist() == [1] * 3 + [2] * 4 + [3] * 3 + [4] + [5] * 3


def test_refining_learns_colours_and_splatams_everything():
    config = MapperConfig()
    assert config.learning_rates(refining=True).tolist() == [0] * 11 + config.learning_rates()[11:].tolist()
    splatam = MAPPERS.get("splatam")
    assert np.array_equal(splatam.learning_rates(refining=True), splatam.learning_rates())


def test_the_default_does_not_learn_opacity():
    rates = MapperConfig().learning_rates()
    assert rates[10] == 0.0 and (np.delete(rates, 10) > 0).all()


def test_recipes_carry_their_name_and_the_default_is_the_defaults():
    assert MAPPERS.get("default") == MapperConfig()
    assert all(mapper_config(name).name == name for name in MAPPERS)
    with pytest.raises(InputError, match="unknown mapper 'splatem'; did you mean 'splatam'"):
        mapper_config("splatem")


def test_splatam_rates_are_the_original_ones():
    rates = MAPPERS.get("splatam").learning_rates()
    assert rates == pytest.approx([1e-4] * 3 + [1e-3] * 4 + [1e-3] * 3 + [5e-2] + [2.5e-3] * 3)
