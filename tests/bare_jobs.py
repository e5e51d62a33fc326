"""Jobs without what most tests of them do not look at."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import pytest


@contextmanager
def bare_jobs() -> Iterator[None]:
    """Draw no pictures of a run, which are four fifths of a small job, and compile no kernels ahead of a comparison.

    Tests of the pictures draw their own. `tests/evaluation/test_end_to_end.py` compiles ahead.
    """
    from activestructure_gym.evaluation.report.pictures import run_figures
    from activestructure_gym.evaluation.running import comparison

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_figures, "draw_run", lambda run, directory: None)
        patch.setattr(comparison, "warming_up", lambda *_: nullcontext())
        yield
