"""Compile the kernels of a comparison before the clock of any run starts, while the scenes are prepared."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any


@contextmanager
def warming_up(policies: Sequence[str], notify: Callable[[str], None] = lambda _: None) -> Iterator[None]:
    """Compile the listed kernels that are not on disk: by helpers while the block runs, the others after it.

    The time of a run contains no compiling then, except for kernels of the user's own code and of unusual settings.
    ``notify`` gets the progress; it is not called if nothing has to be compiled.
    """
    from activestructure_gym.compiling import describe, told_to
    from activestructure_gym.compiling.ahead import listed_kernels, start_helpers
    from activestructure_gym.compiling.progress import begin, conclusion

    missing = [each for each in listed_kernels(feature_modules(policies)) if not each.is_kept()]
    if not missing:
        yield
        return
    began = time.monotonic()
    notify(begin())
    start_helpers(missing)
    with told_to(lambda name: None):
        yield
        for number, each in enumerate(missing, start=1):
            notify(describe(number, time.monotonic() - began, len(missing)))
            each.compile()
    notify(conclusion(len(missing), time.monotonic() - began))


def feature_modules(policies: Sequence[str]) -> set[str]:
    """Return the modules of the features that any of the policies needs."""
    from activestructure_gym.features import FEATURES
    from activestructure_gym.policies import make_policy

    features = {feature for name in policies for feature in make_policy(name).required_features}
    origins: list[Any] = [FEATURES.get(FEATURES.owner(name)) for name in features]
    return {origin.__module__ for origin in origins}
