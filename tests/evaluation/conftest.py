"""What tests of the evaluation have in common."""

from collections.abc import Iterator
from contextlib import nullcontext

import pytest

from activestructure_gym.evaluation.report.pictures import run_figures
from activestructure_gym.evaluation.running import comparison


@pytest.fixture(scope="package", autouse=True)
def undrawn() -> Iterator[None]:
    """Jobs in this process draw no pictures, which is four fifths of a small job; tests of pictures draw their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_figures, "draw_run", lambda run, directory: None)
        yield


@pytest.fixture(scope="package", autouse=True)
def unwarmed() -> Iterator[None]:
    """Compile no kernels ahead of a comparison: two processes of 5 s each. `test_end_to_end` does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison, "warming_up", lambda *_: nullcontext())
        yield
