import dataclasses

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation import store
from activestructure_gym.evaluation.jobs import Job
from activestructure_gym.evaluation.report.results import Results, gather, source_of


def test_cells_and_strata(make_run):
    runs = [make_run("room", "a", 0, psnr=1.0), make_run("room", "a", 1, psnr=2.0), make_run("box", "a", 0, psnr=None)]
    results = Results(runs, [])
    assert results.cells("a", "psnr") == {("room", 0): 1.0, ("room", 1): 2.0}
    assert results.strata("a", "psnr") is None  # not defined on box
    (room,) = results.strata("a", "psnr", "room")
    assert room.tolist() == [1.0, 2.0]
    assert results.strata("a", "planning_seconds", "box")[0].tolist() == [3.5]  # planning, gains, policy


def test_the_typical_run_has_the_median_result(make_run):
    runs = [make_run(seed=seed, completion_ratio=ratio) for seed, ratio in enumerate((70.0, 90.0, 80.0, 60.0))]
    assert Results(runs[:3], []).typical("random", "room").job.seed == 2
    assert Results(runs, []).typical("random", "room").job.seed == 0  # of 60, 70, 80, 90 the lower middle
    assert Results(runs, []).typical("random", "box") is None


def test_the_baseline_is_named_or_the_usual_one(make_run):
    runs = [make_run(policy=policy) for policy in ("activestructure", "random", "pixel_only")]
    assert Results(runs, []).baseline == "pixel_only"
    assert Results(runs, [], "random").baseline == "random"
    assert Results(runs[:1], []).baseline is None
    with pytest.raises(InputError, match="'nobody' is not among the policies .* activestructure, random"):
        Results(runs, [], "nobody")


def test_like_is_compared_with_like(make_run):
    one, other = make_run(), make_run(policy="b")
    changed = dataclasses.replace(other, job=dataclasses.replace(other.job, frame_budget=50))
    with pytest.raises(InputError, match="frame_budget: None, 50"):
        Results([one, changed], [])
    with pytest.raises(InputError, match="at least one finished run"):
        Results([], [])


def test_what_was_asked_for_and_has_no_run_is_missing(make_run, tmp_path):
    run = make_run()
    jobs = {job.name: job.as_dict() for job in (run.job, Job("room", "b", 0), Job("room", "c", 0))}
    record = {"command": "asg compare", "workers": 2, "jobs": jobs, "failed": {"room · c · seed 0": "RuntimeError: no"}}
    source = source_of(tmp_path, record, [run])
    assert source.missing == {"room · b · seed 0": "not run to its end", "room · c · seed 0": "RuntimeError: no"}


def test_a_run_that_stands_in_two_places_counts_once(make_run, tmp_path, monkeypatch):
    runs = [make_run("/x/a.glb"), make_run("/y/a.glb")]
    runs[1] = dataclasses.replace(runs[1], job=dataclasses.replace(runs[1].job, scene_hash="other"))
    for name in "pq":
        (tmp_path / name).mkdir()
        (tmp_path / name / store.DONE).touch()
    monkeypatch.setattr(store, "read_run", lambda directory: runs[directory.name == "q"])
    found = gather([tmp_path / "p", tmp_path / "q", tmp_path / "p"])
    assert [run.scene for run in found.runs] == ["x/a", "y/a"]  # told apart again
    with pytest.raises(InputError, match="neither a comparison"):
        gather([tmp_path])
