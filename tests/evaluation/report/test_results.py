import dataclasses

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import completion, json_files, store
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.report import results
from activestructure_gym.evaluation.report.page.document import html_page
from activestructure_gym.evaluation.report.results import Results, gather, labelled, once, opened, source_of
from activestructure_gym.evaluation.report.tables.columns import aspects, chosen_columns, ratios_text
from activestructure_gym.evaluation.report.tables.formats import latex
from activestructure_gym.evaluation.report.tables.overview import table_rows
from activestructure_gym.evaluation.report.tables.paper import ablation_table


def test_cells_and_strata(make_run):
    runs = [make_run("room", "a", 0, psnr=1.0), make_run("room", "a", 1, psnr=2.0), make_run("box", "a", 0, psnr=None)]
    results = Results(runs, [])
    assert results.cells("a", "psnr") == {("room", 0): 1.0, ("room", 1): 2.0}
    assert results.strata("a", "psnr") is None  # not defined on box
    (room,) = results.strata("a", "psnr", "room")
    assert room.tolist() == [1.0, 2.0]
    assert results.strata("a", "planning_seconds", "box")[0].tolist() == [3.5]  # planning, features, policy


def test_pictures_side_by_side_are_of_one_seed_that_with_the_median_result(make_run):
    ratios = {"a": (70.0, 90.0, 80.0, 60.0), "b": (75.0, 65.0, 85.0, 95.0)}  # means 72.5, 77.5, 82.5, 77.5
    runs = [
        make_run(policy=p, seed=seed, completion_ratio=r) for p, own in ratios.items() for seed, r in enumerate(own)
    ]
    shown = Results(runs, []).shown("room")
    assert [(run.policy, run.job.seed) for run in shown] == [("a", 1), ("b", 1)]  # of equal ones the first seed
    odd = Results([run for run in runs if run.job.seed < 3], []).shown("room")
    assert {run.job.seed for run in odd} == {1}
    assert Results(runs, []).shown("box") == []


def test_a_seed_that_all_have_finished_goes_before_the_median(make_run):
    runs = [make_run(policy="a", seed=seed, completion_ratio=80.0 + seed) for seed in range(3)]
    runs.append(make_run(policy="b", seed=2))
    assert [(run.policy, run.job.seed) for run in Results(runs, []).shown("room")] == [("a", 2), ("b", 2)]


def test_of_many_policies_the_best_and_the_baseline_come_first(make_run):
    runs = [make_run(policy=name, completion_ratio=10.0 * k) for k, name in enumerate("abcdefghi", start=1)]
    assert [run.policy for run in Results(runs, [], "b").foremost("room")] == list("bdefghi")
    assert len(Results(runs[:3], []).foremost("room")) == 3


def test_what_is_found_once_is_not_worked_out_again(make_run):
    asked = []

    @once
    def counted(results, name, digits=1):
        asked.append((name, digits))
        return [name, len(results.runs)]

    one, two = Results([make_run()], []), Results([make_run(), make_run(policy="b")], [])
    assert counted(one, "a") == ["a", 1] and counted(one, "a") is counted(one, "a")
    assert counted(one, "a", digits=2) == ["a", 1] and counted(two, "a") == ["a", 2]  # other results, another answer
    assert asked == [("a", 1), ("a", 2), ("a", 1)]


def test_arrays_read_for_a_look_are_not_kept(make_run):
    run = make_run()
    del run.__dict__["steps"]
    run.directory.mkdir(parents=True)
    (run.directory / "steps.jsonl").write_text('{"frames": 7}\n')
    (copied,) = opened([run])
    assert copied.steps == [{"frames": 7}] and copied.policy == run.policy
    assert "steps" in copied.__dict__ and "steps" not in run.__dict__


def test_the_baseline_is_named_or_the_usual_one(make_run):
    runs = [make_run(policy=policy) for policy in ("activestructure", "random", "pixel_only")]
    assert Results(runs, []).baseline == "pixel_only"
    assert Results(runs, [], "random").baseline == "random"
    assert Results(runs[:1], []).baseline is None
    with pytest.raises(InputError, match="'nobody' is not among the policies .* activestructure, random"):
        Results(runs, [], "nobody")


def test_like_is_compared_with_like(make_run):
    one, other = make_run(), make_run(policy="b")
    changed = dataclasses.replace(other, job=dataclasses.replace(other.job, conditions=Conditions(frame_budget=50)))
    with pytest.raises(InputError, match="frame_budget: None, 50"):
        Results([one, changed], [])
    with pytest.raises(InputError, match="at least one finished run"):
        Results([], [])


def test_what_only_some_runs_were_told_is_another_condition(make_run):
    one, other = make_run(), make_run(policy="b")
    told = dataclasses.replace(other.job, conditions=Conditions(overrides={"mapper.iterations": 8}))
    with pytest.raises(InputError, match="set mapper.iterations: not given, 8"):
        Results([one, dataclasses.replace(other, job=told)], [])


def test_a_file_that_was_changed_is_another_scene(make_run):
    runs = [make_run(), make_run(policy="b")]
    with_content = [
        dataclasses.replace(run, job=dataclasses.replace(run.job, scene_hash=digit * 64))
        for run, digit in zip(runs, "ac")
    ]
    with pytest.raises(InputError, match="content of room: aaaaaaaa, cccccccc"):
        Results(with_content, [])


def test_what_failed_and_was_finished_later_is_not_missing(make_run, tmp_path):
    run, lost = make_run(), Job("room", "b", 0)
    jobs = {job.name: job.as_dict() for job in (run.job, lost)}
    record = {"jobs": jobs, "failed": {run.job.name: "exit code 1", lost.name: "MemoryError: elsewhere"}}
    assert source_of(tmp_path, record, [run]).missing == {lost.title: "MemoryError: elsewhere"}


def test_two_scenes_of_one_file_name_are_missing_twice_with_their_own_errors(tmp_path):
    lost = [Job(f"/data/{room}/mesh.ply", "random", 0, room[-1] * 64) for room in ("room_0", "room_1")]
    record = {"jobs": {job.name: job.as_dict() for job in lost}, "failed": {lost[1].name: "exit code 1"}}
    assert source_of(tmp_path, record, []).missing == {
        "room_0/mesh · random · seed 0": "not finished", "room_1/mesh · random · seed 0": "exit code 1"
    }  # fmt: skip


def test_a_job_that_failed_in_one_directory_and_ended_in_another_is_not_missing(make_run, tmp_path, monkeypatch):
    run, lost = make_run(), Job("room", "b", 0)
    record = {"jobs": {job.name: job.as_dict() for job in (run.job, lost)}, "failed": {run.job.name: "exit code 1"}}
    for name in "pq":
        (tmp_path / name).mkdir()
        json_files.write_json(tmp_path / name / store.COMPARISON, record)
    monkeypatch.setattr(results, "readable_runs", lambda place, jobs: ([run] if place.name == "q" else [], {}))
    assert gather([tmp_path / "p", tmp_path / "q"]).missing == {lost.title: "not finished"}


def test_the_same_episode_with_and_without_a_further_protocol_counts_once(make_run, tmp_path, monkeypatch):
    runs = [make_run(seed=0), make_run(seed=1), make_run(seed=0)]
    further = dataclasses.replace(runs[0].job, conditions=Conditions(also=("activegamer",)))
    runs[2].__dict__["job"] = further
    for name in "abc":
        (tmp_path / name).mkdir()
        (tmp_path / name / completion.DONE).touch()
    monkeypatch.setattr(store, "read_run", lambda directory: runs["abc".index(directory.name)])
    monkeypatch.setattr(store, "read_shown", lambda run: None)
    found = gather([tmp_path / name for name in "abc"])
    assert [run.job for run in found.runs] == [runs[0].job, runs[1].job]
    (row,) = table_rows(found.runs)
    assert row.runs == 2
    own = runs[0].protocols
    runs[2].__dict__["protocols"] = {**own, "activegamer": own["standard"]}  # more were measured, so none gets lost
    assert [run.job for run in Results(runs, []).runs] == [further, runs[1].job]


def test_runs_of_two_protocols_are_not_mixed_and_each_is_reported(make_run):
    new = make_run(policy="b", tsdf_completion_ratio=85.0, observed=91.25)
    other = make_run()
    other.__dict__["job"] = dataclasses.replace(other.job, conditions=Conditions(protocol=StandardProtocol(views=3)))
    with pytest.raises(InputError, match="protocol views: 64, 3"):
        Results([new, other], [])
    assert ratios_text(new) == "C.R. 80.0 %, C.R. surface 85.0 %, observed 91.2 %"
    assert ratios_text(other) == "C.R. 80.0 %, C.R. surface –, observed –"
    shown = {run.policy: [column.header for column in aspects([run])[0].columns] for run in (new, other)}
    assert shown["b"][2:5] == ["C.R.", "C.R. surface", "observed"]
    assert shown["random"][2:4] == ["C.R.", "Prec."]
    for run in (new, other):
        page = html_page(Results([run], []))
        assert ratios_text(run) in page and (">C.R. surface (%)" in page) == (run is new)


def test_what_was_asked_for_and_has_no_run_is_missing(make_run, tmp_path):
    run = make_run()
    lost = [Job("room", "b", 0), Job("room", "c", 0)]
    jobs = {job.name: job.as_dict() for job in (run.job, *lost)}
    record = {"command": "asg compare", "workers": 2, "jobs": jobs, "failed": {lost[1].name: "RuntimeError: no"}}
    source = source_of(tmp_path, record, [run])
    assert source.missing == {"room · b · seed 0": "not finished", "room · c · seed 0": "RuntimeError: no"}


def test_one_scene_in_two_folders_is_one_scene(make_run, tmp_path, monkeypatch):
    runs = [make_run("/x/a.glb"), make_run("/y/a.glb", policy="b")]
    runs = [dataclasses.replace(run, job=dataclasses.replace(run.job, scene_hash="ab" * 32)) for run in runs]
    for name in "pq":
        (tmp_path / name).mkdir()
        (tmp_path / name / completion.DONE).touch()
    monkeypatch.setattr(store, "read_run", lambda directory: runs[directory.name == "q"])
    monkeypatch.setattr(store, "read_shown", lambda run: None)
    found = gather([tmp_path / "p", tmp_path / "q"])
    assert found.scenes == ["a"] and found.policies == ["random", "b"]
    assert set(found.cells("random", "psnr")) == set(found.cells("b", "psnr")) == {("a", 0)}


def test_a_run_that_stands_in_two_places_counts_once(make_run, tmp_path, monkeypatch):
    runs = [make_run("/x/a.glb"), make_run("/y/a.glb")]
    runs[1] = dataclasses.replace(runs[1], job=dataclasses.replace(runs[1].job, scene_hash="other"))
    for name in "pq":
        (tmp_path / name).mkdir()
        (tmp_path / name / completion.DONE).touch()
    monkeypatch.setattr(store, "read_run", lambda directory: runs[directory.name == "q"])
    monkeypatch.setattr(store, "read_shown", lambda run: None)
    found = gather([tmp_path / "p", tmp_path / "q", tmp_path / "p"])
    assert [run.scene for run in found.runs] == ["x/a", "y/a"]  # told apart again
    with pytest.raises(InputError, match="has no finished run: it has no .done file"):
        gather([tmp_path])


def test_labels_replace_names_of_policies_and_scenes(make_run):
    runs = [make_run("room", "a"), make_run("room", "b"), make_run("box", "a")]
    named = labelled(runs, {"a": "Ours", "box": "Room B"})
    assert [(run.policy, run.scene) for run in named] == [("Ours", "room"), ("b", "room"), ("Ours", "Room B")]
    assert [run.policy for run in runs] == ["a", "b", "a"]  # the runs themselves do not change
    assert labelled(runs, {}) == runs
    for labels, message in (
        ({"c": "Ours"}, "unknown policy or scene 'c'"),
        ({"a": "b"}, "two names would have the label 'b'"),
        ({"a": "One", "b": "One"}, "two names would have the label 'One'"),
    ):
        with pytest.raises(InputError, match=message):
            labelled(runs, labels)


def test_chosen_columns_are_one_table(make_run):
    runs = [make_run("room", "a", psnr=20.0), make_run("room", "b", psnr=21.0)]
    aspect = chosen_columns(("psnr", "metres"), runs)
    assert [column.key for column in aspect.columns] == ["psnr", "metres"]
    table = ablation_table(Results(runs, []), aspect)
    assert [row[1].text for row in table.rows] == ["20.00", "21.00"] and table.rows[1][1].rank == 1
    assert r"\toprule" in latex(table) and r"\bottomrule" in latex(table)
    with pytest.raises(InputError, match="unknown column 'psnrr'; did you mean 'psnr'"):
        chosen_columns(("psnrr",), runs)
