"""What tests of the evaluation have in common."""

from collections.abc import Iterator

import pytest

from activestructure_gym.evaluation.report.pictures import run_figures


@pytest.fixture(scope="package", autouse=True)
def undrawn() -> Iterator[None]:
    """Jobs in this process draw no pictures, which is four fifths of a small job; tests of pictures draw their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_figures, "draw_run", lambda run, directory: None)
        yield
