import re
from pathlib import Path

from activestructure_gym.evaluation.report.summary import write_report

COMPARISON = {"command": "asg compare --scenes room", "workers": 2, "failed": {}}


def linked(summary: Path) -> list[Path]:
    return [summary.parent / target for target in re.findall(r"\]\(\./([^)]+)\)", summary.read_text())]


def test_everything_is_written_and_linked(make_run, tmp_path):
    runs = [make_run(scene, policy, planes=policy == "a") for scene in ("room", "box?seed=2") for policy in ("a", "b")]
    for run in runs:
        run.directory.mkdir(parents=True)
    files = write_report(tmp_path, runs, COMPARISON)
    summary = files[-1]
    assert summary.name == "summary.md" and all(file.is_file() for file in files)
    targets = linked(summary)
    assert all(target.exists() for target in targets)
    assert {file for file in files if file.suffix == ".png"} <= set(targets)
    text = summary.read_text()
    for words in ("`asg compare --scenes room`", "| average |", "Protocol `standard`", "## box?seed=2", "made up"):
        assert words in text


def test_scenes_whose_names_look_alike_in_a_file_name_keep_their_own_pictures(make_run, tmp_path, recwarn):
    runs = [make_run(scene, "a") for scene in ("家", "室", "a b", "A?b")]
    for run in runs:
        run.directory.mkdir(parents=True, exist_ok=True)
    files = write_report(tmp_path, runs, COMPARISON)
    names = [file.name.lower() for file in files]
    assert len(set(names)) == len(names) and all(file.is_file() for file in files)
    assert {"plans-unnamed.png", "plans-unnamed-2.png", "plans-a-b.png", "plans-a-b-2.png"} <= set(names)
    assert not [warning for warning in recwarn if "Glyph" in str(warning.message)]


def test_graphs_are_shown_with_a_line_each_where_runs_kept_them(make_run, tmp_path):
    runs = [make_run(planes=True)]
    for run in runs:
        run.directory.mkdir(parents=True)
    names = {"psg_plans.png", "psg_3d.png", "phases.png"}
    files = write_report(tmp_path, runs, COMPARISON)
    text = files[-1].read_text()
    assert names <= {file.name for file in files} and "Plane Scene Graphs from above" in text
    for run in runs:
        run.__dict__["graph"] = None
    files = write_report(tmp_path, runs, COMPARISON)
    assert not names & {file.name for file in files} and "psg_" not in files[-1].read_text().split("## How")[0]


def test_what_failed_is_named_and_not_counted(make_run, tmp_path):
    run = make_run()
    run.directory.mkdir(parents=True)
    failed = {"room · b · seed 0": "RuntimeError: no"}
    summary = write_report(tmp_path, [run], COMPARISON | {"failed": failed})[-1].read_text()
    assert "Not finished, and not counted (1)" in summary and "RuntimeError: no" in summary


def test_collisions_are_said(make_run, tmp_path):
    run = make_run(collisions=3)
    run.directory.mkdir(parents=True)
    assert "through the true mesh: 3" in write_report(tmp_path, [run], COMPARISON)[-1].read_text()


def test_pictures_show_a_seed_that_all_policies_have(make_run, tmp_path):
    runs = [make_run(policy="a", seed=0), make_run(policy="a", seed=1), make_run(policy="b", seed=1)]
    for run in runs:
        run.directory.mkdir(parents=True)
    shown = []
    from activestructure_gym.evaluation.report import summary as module

    original = module.compare_plans
    try:
        module.compare_plans = lambda runs, title: shown.extend(runs) or original(runs, title=title)
        write_report(tmp_path, runs, COMPARISON)
    finally:
        module.compare_plans = original
    assert [(run.job.policy, run.job.seed) for run in shown] == [("a", 1), ("b", 1)]
