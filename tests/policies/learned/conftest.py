"""Random observations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.policies.learned.toys import Observation, random_observation


@pytest.fixture
def make_observation(rng: np.random.Generator) -> Callable[..., Observation]:
    """``make_observation(rows=.., valid=.., planes=..)``, another one at every call."""

    def make(rows: int = 16, valid: int = 9, planes: int = 7, features: int = 2) -> Observation:
        return random_observation(rng, rows, valid, planes, features)

    return make
