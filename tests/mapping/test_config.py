"""Wrong settings are refused by name; the learning rates follow the scene's size."""

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
        {"color_rate": 0.0},
        {"depth_weight": float("nan")},
        {"scene_radius": 0.0},
        {"max_seed_stride": 1},
        {"seed_elongation": 0.5},
        {"coarse_ratio": float("nan")},
        {"wide_ratio": 0.9},
        {"wide_sigma": 0.0},
        {"mean_rate_radius": 0.0},
        {"prune_steps": (0, -2)},
        {"prune_steps": (1.5,)},
    ],
)
def test_wrong_values_are_refused_by_name(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        MapperConfig(**change)


def test_only_the_means_rate_grows_with_the_scene():
    small, large = MapperConfig().learning_rates(2.0), MapperConfig().learning_rates(6.0)
    assert small[:3] == pytest.approx([2e-4] * 3) and large[:3] == pytest.approx([6e-4] * 3)
    assert (small[3:] == large[3:]).all()
    assert small[3:] == pytest.approx([2e-3] * 4 + [6e-3] * 3 + [0.1] + [2.5e-3] * 3)


def test_recipes_carry_their_name_and_the_default_is_the_defaults():
    assert MAPPERS["default"] == MapperConfig()
    assert all(config.name == name for name, config in MAPPERS.items())
    with pytest.raises(InputError, match="unknown mapper 'splatem'; did you mean 'splatam'"):
        MapperConfig(name="splatem")


def test_splatam_rates_are_the_original_ones_in_every_scene():
    rates = MAPPERS["splatam"].learning_rates(7.0)
    assert rates == pytest.approx([1e-4] * 3 + [1e-3] * 4 + [1e-3] * 3 + [5e-2] + [2.5e-3] * 3)
