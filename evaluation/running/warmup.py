"""Compile the kernels of a comparison while its scenes are prepared, so that no run's time includes compilation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager


@contextmanager
def warming_up(policies: Sequence[str], notify: Callable[[str], None] = lambda _: None) -> Iterator[None]:
    """Compile the listed kernels that are not on disk: in helper processes while the block runs, the rest after it.

    Only kernels of plug-in code or of unusual settings may still be compiled during a run. ``notify`` is called with
    the progress if any kernel is compiled.
    """
    from activestructure_gym.compiling import describe, told_to
    from activestructure_gym.compiling.ahead import listed_kernels, start_helpers

    missing = [each for each in listed_kernels(feature_modules(policies)) if not each.is_kept()]
    if not missing:
        yield
        return
    notify(describe(0, 0.0, len(missing)))
    start_helpers(missing)
    with told_to(lambda name: None):
        yield
        began = time.monotonic()  # the scenes took the time before
        for number, each in enumerate(missing, start=1):
            notify(describe(number, time.monotonic() - began, len(missing)))
            each.compile()
    notify("all kernels are compiled")


def feature_modules(policies: Sequence[str]) -> set[str]:
    """Return the modules of the features that at least one of the policies needs."""
    from activestructure_gym.features import FEATURES
    from activestructure_gym.policies import make_policy

    features = {feature for name in policies for feature in make_policy(name).required_features}
    return {FEATURES.get(FEATURES.owner(name)).__module__ for name in features}
