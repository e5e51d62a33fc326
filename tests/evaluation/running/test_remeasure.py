"""Measuring what lies on disk."""

from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.remeasure import measure_again


def test_measuring_a_run_again_runs_no_code_that_its_files_name(tmp_path):
    hacked = tmp_path / "hacked"
    job = Job(f"subprocess:getoutput?cmd=touch {hacked}", "random", 0)
    with pytest.raises(InputError, match="config.json' names the scene .* add --trust-code"):
        measure_again(Run(Path("run"), "scene", job, {}, {}, {}), StandardProtocol())
    assert not hacked.exists()
