import numpy as np

from activestructure_gym.envs.observation import _quantile


def test_quantiles_are_those_of_numpy_to_the_last_digit():
    rng = np.random.default_rng(0)
    for count in (1, 2, 3, 11, 40):
        values = rng.uniform(5, 40, count)
        for share in (0.1, 0.25, 0.5):
            assert _quantile(values, share) == np.quantile(values, share)
