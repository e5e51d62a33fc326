"""Wrong settings are refused by name; learning rates and recipes."""

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.mapping import MAPPERS, MapperConfig


@pytest.mark.parametrize(
    "change",
    [
        {"seed_stride": 0},
        {"iterations": -1},
        {"max_gaussians": 0},
        {"seed_opacity": 1.0},
        {"covered_alpha": 1.5},
        {"color_rate": -1e-3},
        {"depth_weight": float("nan")},
        {"scene_radius": 0.0},
        {"coarse_ratio": float("nan")},
        {"seed_spacing": 0.0},
        {"seed_pixels": -1.0},
        {"texture_contrast": 1.5},
        {"edge_footprint": -0.1},
        {"prune_steps": (0, -2)},
        {"prune_steps": (1.5,)},
    ],
)
def test_wrong_values_are_refused_by_name(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        MapperConfig(**change)


def test_learning_rates_stand_in_the_rows_of_their_parameters():
    rates = MapperConfig().learning_rates()
    assert rates == pytest.approx([3e-5] * 3 + [1e-4] * 4 + [6e-4] * 3 + [0.0] + [3e-4] * 3)


def test_recipes_carry_their_name_and_the_default_is_the_defaults():
    assert MAPPERS["default"] == MapperConfig()
    assert all(config.name == name for name, config in MAPPERS.items())
    with pytest.raises(InputError, match="unknown mapper 'splatem'; did you mean 'splatam'"):
        MapperConfig(name="splatem")


def test_splatam_rates_are_the_original_ones():
    rates = MAPPERS["splatam"].learning_rates()
    assert rates == pytest.approx([1e-4] * 3 + [1e-3] * 4 + [1e-3] * 3 + [5e-2] + [2.5e-3] * 3)
