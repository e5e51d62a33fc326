"""What the commands say, without what compiling says: which test is the first to need a kernel is chance."""

import pytest

from activestructure_gym.compiling.progress import Progress


@pytest.fixture(autouse=True)
def no_lines_about_compiling(monkeypatch):
    """The lines of other tests' compiling come seconds later, from a thread."""
    monkeypatch.setattr(Progress, "report", lambda self: None)
    monkeypatch.setattr(Progress, "conclude", lambda self: None)
