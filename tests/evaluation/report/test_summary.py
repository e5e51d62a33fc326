import errno
import re
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import TABLES
from activestructure_gym.evaluation.report import summary
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.summary import PAGE, all_tables, write_report
from activestructure_gym.evaluation.report.tables.columns import QUALITY
from activestructure_gym.evaluation.report.tables.formats import to_csv
from activestructure_gym.evaluation.report.tables.verdicts import improvement_table

COMPARISON = {"command": "asg compare --scenes room", "workers": 2, "failed": {}}


def linked(summary: Path) -> list[Path]:
    return [summary.parent / target for target in re.findall(r"\]\(\./([^)]+)\)", summary.read_text())]


def made(runs):
    for run in runs:
        run.directory.mkdir(parents=True, exist_ok=True)
    return runs


def test_everything_is_written_and_linked(make_run, tmp_path):
    runs = made([make_run(scene, policy) for scene in ("room", "box?seed=2") for policy in "ab"])
    files = write_report(tmp_path, runs, COMPARISON)
    summary, page = files[-2:]
    assert (summary.name, page.name) == ("summary.md", PAGE) and all(file.is_file() for file in files)
    targets = linked(summary)
    assert all(target.exists() for target in targets)
    assert {file for file in files if file.suffix in (".png", ".svg", ".html")} <= set(targets)
    text = summary.read_text()
    for words in ("`asg compare --scenes room`", "| average |", "Protocol `standard`", "## box?seed=2", "made up",
                  "## Against a", "## Area under the curves", "2 parallel jobs", "t intervals"):  # fmt: skip
        assert words in text
    names = {file.name for file in files if file.parent.name == TABLES}
    for name in ("quality", "variants", "time", "differences", "aggregates", "areas", "costs", "overview"):
        assert {f"{name}.md", f"{name}.csv", f"{name}.tex"} <= names


@pytest.mark.slow
def test_more_policies_than_colours_have_a_panel_each(make_run, tmp_path):
    names = "abcdefghi"
    few = write_report(tmp_path, made([make_run(policy=name) for name in names[:8]]), COMPARISON)
    assert "policies.svg" not in {file.name for file in few}
    many = write_report(tmp_path, made([make_run(policy=name) for name in names]), COMPARISON)
    picture = next(file for file in many if file.name == "policies.svg")
    assert picture in linked(many[-2]) and picture.read_text().count('class="panel ') == 2 * 9
    assert "9 policies on 1 scene" in many[-1].read_text()


def test_the_same_runs_give_the_same_report(make_run, tmp_path):
    runs = made([make_run(policy="a", seed=0, planes=True), make_run(policy="a", seed=1)])
    first = {file.name: file.read_bytes() for file in write_report(tmp_path, runs, COMPARISON)}
    assert {file.name: file.read_bytes() for file in write_report(tmp_path, runs, COMPARISON)} == first


def test_scenes_whose_names_look_alike_in_a_file_name_keep_their_own_pictures(make_run, tmp_path, recwarn):
    runs = made([make_run(scene, "a") for scene in ("家", "室", "a b", "A?b")])
    files = write_report(tmp_path, runs, COMPARISON)
    names = [file.name.lower() for file in files]
    assert len(set(names)) == len(names) and all(file.is_file() for file in files)
    assert {"plans-unnamed.png", "plans-unnamed-2.png", "plans-a-b.png", "plans-a-b-2.png"} <= set(names)
    assert not [warning for warning in recwarn if "Glyph" in str(warning.message)]


def test_graphs_are_shown_where_runs_kept_them(make_run, tmp_path):
    (run,) = made([make_run(planes=True)])
    page = write_report(tmp_path, [run], COMPARISON)[-1].read_text()
    assert "Plane Scene Graphs" in page and "planes of random in 3D, by deficit" in page
    run.__dict__["graph"] = None
    assert "Plane Scene Graphs" not in write_report(tmp_path, [run], COMPARISON)[-1].read_text()


def test_what_failed_is_named_and_not_counted(make_run, tmp_path):
    lost = Job("room", "b", 0)
    record = COMPARISON | {"jobs": {lost.name: lost.as_dict()}, "failed": {lost.name: "RuntimeError: no"}}
    files = write_report(tmp_path, made([make_run()]), record, "b")  # whose runs all failed
    assert "Not finished, not counted (1)" in files[-2].read_text() and "RuntimeError: no" in files[-2].read_text()
    assert "RuntimeError: no" in files[-1].read_text()


def test_collisions_are_said(make_run, tmp_path):
    text = write_report(tmp_path, made([make_run(collisions=3)]), COMPARISON)[-2].read_text()
    assert "through the true mesh: 3 (must be 0!)" in text


def test_choices_of_rows_without_a_candidate_are_said(make_run, tmp_path):
    text = write_report(tmp_path, made([make_run(invalid_actions=1)]), COMPARISON)[-2].read_text()
    assert "chose 1 row without a candidate in 1 of 1 run" in text


def test_a_report_is_written_whole_or_not_at_all(make_run, tmp_path, monkeypatch):
    runs = made([make_run(policy=policy) for policy in "ab"])
    out = tmp_path / "out"
    files = {file.relative_to(out): file.read_bytes() for file in write_report(out, runs, COMPARISON)}
    (out / "mine.txt").write_text("kept")

    def refuse(*given):
        raise InputError("at the very end")

    with monkeypatch.context() as patched:
        patched.setattr(summary, "html_page", refuse)
        for place in (out, tmp_path / "new" / "er"):
            with pytest.raises(InputError, match="at the very end"):
                write_report(place, made([make_run(policy="c")]), COMPARISON)
    assert not (tmp_path / "new" / "er").exists()
    assert {file.relative_to(out): file.read_bytes() for file in out.rglob("*") if file.is_file()} == files | {
        Path("mine.txt"): b"kept"
    }
    # Nor is anything replaced where one of the files cannot be.
    (out / PAGE).unlink()
    (out / PAGE).mkdir()
    with pytest.raises(InputError, match="out' cannot be written: 'report.html' in it is a folder"):
        write_report(out, made([make_run(policy="c")]), COMPARISON)
    assert (out / "results.csv").read_bytes() == files[Path("results.csv")]


def test_a_full_disk_is_one_sentence(make_run, tmp_path, monkeypatch):
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(summary, "runs_csv", lambda runs: (_ for _ in ()).throw(full))
    with pytest.raises(InputError, match="out' cannot be written: No space left on device$"):
        write_report(tmp_path / "out", made([make_run()]), COMPARISON)
    assert not (tmp_path / "out").exists()


def test_runs_that_kept_other_views_are_not_shown_side_by_side(make_run, tmp_path):
    one, other = made([make_run(policy=policy) for policy in "ab"])
    other.__dict__["pictures"] = {**other.pictures, "true": other.pictures["true"][:2]}
    with pytest.raises(InputError, match="have not stored the same held-out views of room"):
        write_report(tmp_path / "out", [one, other], COMPARISON)
    assert not (tmp_path / "out").exists()


def test_the_numbers_of_the_tables(make_run):
    runs = [
        make_run(scene, policy, seed, completion_ratio=80.0 + seed * (1 if policy == "a" else -2),
                 psnr=20.0 + 3 * seed + (2 - 4 * seed * (scene == "box")) * (policy == "a"))
        for scene in ("room", "box") for policy in "ab" for seed in range(3)
    ]  # fmt: skip
    results = Results(runs, [], "b")
    found = {table.name: to_csv(table).splitlines() for table in all_tables(results)}
    # C.R.: differences 0, 3, 6 in both scenes, standard error sqrt(3 + 3) / 2, 4 degrees of freedom. PSNR: 2, 2, 2 and
    # 2, -2, -6, standard error sqrt(16 / 3) / 2, 2 degrees.
    assert [row for row in found["differences"] if "C.R. (" in row or "PSNR (" in row] == [
        'a,C.R. (%) ↑,"+3.0 [-0.4, +6.4]",no significant difference,4 / 2 / 0,0.9444444444444444',
        'a,PSNR (dB) ↑,"0.00 [-4.97, +4.97]",no significant difference,4 / 0 / 2,0.4722222222222222',
    ]
    assert found["areas"][1] == (
        'a,"50.3 [49.6, 51.0]","50.6 [49.9, 51.3]","50.6 [49.9, 51.3]",'
        '"12.48 [11.35, 13.62]","12.50 [11.37, 13.63]","12.50 [11.37, 13.63]"'
    )
    assert found["aggregates"][15] == 'PSNR (dB) ↑,IQM,"22.50 [18.54, 26.46]","23.00 [18.35, 27.65]"'
    (psnr,) = (column for column in QUALITY if column.key == "psnr")
    matrix = improvement_table(results, psnr)
    assert to_csv(matrix).splitlines()[1:] == ["a,–,0.4722222222222222", "b,0.5277777777777778,–"]
