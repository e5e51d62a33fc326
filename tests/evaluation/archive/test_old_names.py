"""Runs of format 2 are read under the names that their policies have now."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import store
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.old_names import RENAMED, current_name
from activestructure_gym.evaluation.report.results import gather
from activestructure_gym.evaluation.running.resuming import recorded_jobs
from activestructure_gym.policies import POLICIES, make_policy
from tests.evaluation.written_runs import write_comparison, write_run


def jobs(*policies: str) -> list[Job]:
    return [Job("room", policy, 0, scene_hash="ab" * 32) for policy in policies]


def of_format_2(directory: Path) -> Path:
    """The same files as that format had them."""
    for file in (*directory.rglob("config.json"), *directory.rglob("metrics.json"), *directory.rglob("compare.json")):
        content = json.loads(file.read_text())
        assert content["format"] == store.FORMAT_VERSION == 3
        file.write_text(json.dumps(content | {"format": 2}))
    for mark in directory.rglob(store.DONE):
        mark.write_text(mark.read_text().splitlines()[0] + "\n")
    return directory


def test_every_old_name_leads_to_a_policy_of_today() -> None:
    assert len(RENAMED) == 16 and set(RENAMED.values()) <= set(POLICIES)
    assert current_name("fisherrf?travel=shared", 2) == "fisherrf_cov?travel=shared"
    assert current_name("popgs_logdet_block_pure", 2) == "popgs_logdet_block"
    assert current_name("fisherrf", 3) == "fisherrf" and current_name("naruto", 2) == "naruto"
    with pytest.raises(InputError, match="did you mean 'gauss_mi'"):
        make_policy("gauss_mi_pure")


def test_old_and_new_runs_in_one_report_are_not_mixed(tmp_path: Path) -> None:
    old = of_format_2(write_comparison(tmp_path / "old", jobs("fisherrf", "fisherrf_pure", "random")))
    new = write_comparison(tmp_path / "new", jobs("fisherrf"))
    assert [run.policy for run in open_comparison(old)] == ["fisherrf_cov", "fisherrf", "random"]
    single = store.read_run(of_format_2(write_run(tmp_path / "one" / "run", jobs("gauss_mi")[0])))
    assert single.policy == "gauss_mi_cov" and single.job.policy == "gauss_mi"
    for places in ([old, new], [new, old]):  # today's `fisherrf` is old's `fisherrf_pure`, and not its `fisherrf`
        assert sorted(run.policy for run in gather(places).runs) == ["fisherrf", "fisherrf_cov", "random"]


def test_a_comparison_with_old_names_is_read_and_not_gone_on_with(tmp_path: Path) -> None:
    old = of_format_2(write_comparison(tmp_path / "old", jobs("fisherrf_pure", "random")))
    with pytest.raises(InputError, match="'fisherrf_pure' was the name of what is 'fisherrf' now"):
        recorded_jobs(old)
    other = of_format_2(write_comparison(tmp_path / "other", jobs("naruto", "random")))
    assert [job.policy for job in recorded_jobs(other)] == ["naruto", "random"]


def test_an_old_run_is_not_taken_for_one_of_the_policy_that_has_its_name_now(tmp_path: Path) -> None:
    job = jobs("fisherrf")[0]
    directory = write_run(tmp_path / "runs" / job.name, job)
    assert store.damage_of(directory, job) is None
    said = store.damage_of(of_format_2(directory), job)
    assert said is not None and "is of 'fisherrf_cov', which was called 'fisherrf'" in said
