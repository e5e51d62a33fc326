"""What the commands say, without what compiling says: which test is the first to need a kernel is chance."""

import pytest

from activestructure_gym.compiling.progress import Progress
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running import comparison
from activestructure_gym.evaluation.running.comparison import Comparison, Result


@pytest.fixture(autouse=True)
def no_lines_about_compiling(monkeypatch):
    """The lines of other tests' compiling come seconds later, from a thread."""
    monkeypatch.setattr(Progress, "report", lambda self: None)
    monkeypatch.setattr(Progress, "conclude", lambda self: None)


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """What `run_comparison` is asked for; nothing runs."""
    monkeypatch.chdir(tmp_path)
    calls = []

    def prepare(self, notify):
        calls.append(self)
        return [Job(self.scenes[0], (self.policies or ("random",))[0], self.seeds[0], conditions=self.conditions)]

    def run(jobs, directory, listener, **options):
        calls.append((jobs, directory, options))
        return Result([], [], 0)

    monkeypatch.setattr(Comparison, "prepare", prepare)
    monkeypatch.setattr(comparison, "run_comparison", run)
    return calls
