"""Measuring what lies on disk."""

from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import Run
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.reproduction.remeasure import measure_again, measure_file
from activestructure_gym.mapping.gaussian_map import GaussianMap
from activestructure_gym.mapping.ply import write_ply


def test_measuring_a_run_again_runs_no_code_that_its_files_name(tmp_path):
    hacked = tmp_path / "hacked"
    job = Job(f"subprocess:getoutput?cmd=touch {hacked}", "random", 0)
    with pytest.raises(InputError, match="config.json' names the scene .* add --trust-code"):
        measure_again(Run(Path("run"), "scene", job, {}, {}, {}), StandardProtocol())
    assert not hacked.exists()


def test_measuring_a_run_again_asks_no_trust_for_a_policy_that_nobody_calls(tmp_path):
    job = Job(
        "there is no such scene",
        "some_policy:Mine",
        0,
        conditions=Conditions(overrides=(("features", ("some_feature:mine",)),)),
    )
    with pytest.raises(InputError, match="trajectory.npz' is missing"):  # which is read after who is trusted
        measure_again(Run(tmp_path, "scene", job, {}, {}, {}), StandardProtocol())


@pytest.mark.parametrize("up", ["y", "-y"])
def test_a_map_that_says_it_is_not_z_up_is_refused(up, tmp_path):
    write_ply(GaussianMap(), tmp_path / "map.ply", up=up)
    with pytest.raises(InputError, match=f"has {up} up, but a map is measured with z up"):
        measure_file(tmp_path / "map.ply", "box", StandardProtocol())
