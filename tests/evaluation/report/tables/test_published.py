"""The paper's values as printed, and finished runs beside them."""

import numpy as np
import pytest

from activestructure_gym.evaluation.archive.store import TABLES
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.summary import PAGE, write_results
from activestructure_gym.evaluation.report.tables.formats import markdown
from activestructure_gym.evaluation.report.tables.published import (
    PUBLISHED,
    averages_table,
    published_tables,
    scenes_table,
)

REPLICA, MP3D = PUBLISHED


def rows(table):
    return [[cell.text for cell in row] for row in table.rows]


@pytest.mark.parametrize("published", PUBLISHED, ids=["replica", "mp3d"])
def test_what_is_printed_as_average_is_the_average_of_the_scenes(published):
    """The paper's own arithmetic finds a slip of the pen."""
    odd = []
    for system, metrics in published.values.items():
        for metric, (*scenes, average) in metrics.items():
            assert len(scenes) == len(published.dataset.scenes)
            if average is None:
                assert None in scenes
                continue
            digits = 3 if metric in ("SSIM", "LPIPS") else 2
            if abs(np.mean(scenes) - average) > 0.6 * 10.0**-digits:
                odd.append((system, metric))
    assert odd == []


def test_a_system_of_the_paper_stands_beside_its_counterpart_here(make_run):
    runs = [
        make_run("replica:/data/office_2", policy, seed, psnr=20.0 + seed)
        for policy in ("naruto", "mine")
        for seed in (0, 1)
    ]
    runs += [make_run("replica:R0", "naruto", 0, psnr=30.0), make_run("box", "naruto", 0, psnr=90.0)]
    table = averages_table(REPLICA, Results(runs, []))
    found = rows(table)
    at = next(i for i, row in enumerate(found) if row[:3] == ["NARUTO", "active", "published"])
    assert found[at][3] == "6 of Replica" and found[at][4:] == ["–"] * 6  # it did not finish two
    own = found[at + 1]
    # The box is none of the dataset's scenes and does not count: (20.5 + 30) / 2.
    assert own[:4] == ["NARUTO", "active", "here: naruto", "2 of Replica"] and own[7].startswith("25.25")
    assert found[-1][:4] == ["mine", "active", "here", "1 of Replica"] and found[-1][7].startswith("20.50")
    assert "another dataset" not in table.caption and "60.15" in next(row for row in found if row[0] == "ActiveINR")
    assert "by their scene's name alone" in table.caption
    assert "by their scene's name alone" in scenes_table(REPLICA, Results(runs, [])).caption
    by_scene = rows(scenes_table(REPLICA, Results(runs, [])))
    naruto = next(row for row in by_scene if row[0] == "naruto, here" and row[1].startswith("PSNR"))
    assert naruto[2:] == ["–", "–", "20.50", "–", "–", "30.00", "–", "–", "–"]  # no average of two out of eight


def test_runs_of_other_scenes_say_so(make_run):
    table = averages_table(MP3D, Results([make_run("box", "activestructure"), make_run("room", "activestructure")], []))
    own = next(row for row in rows(table) if row[2] == "here: activestructure")
    assert own[3] == "another dataset: box, room" and "are of another dataset" in table.caption
    assert "name alone" not in table.caption
    assert "No run here" in scenes_table(MP3D, Results([make_run("box", "activestructure")], [])).caption


def test_what_followed_a_trajectory_is_compared_by_its_mapper(make_run):
    run = make_run("box", "trajectory:passive?mapper=splatam", psnr=11.0)
    run.config["configuration"]["mapper"] = {"name": "splatam"}
    planner = make_run("box", "splatam", psnr=99.0)  # somebody's policy that is called so
    found = rows(averages_table(REPLICA, Results([run, planner], [])))
    own = [row for row in found if row[0] == "SplaTAM"]
    assert [row[2] for row in own] == ["published", "here: trajectory:passive?mapper=splatam"]
    assert own[1][1] == "passive" and own[1][7] == "11.00"


def test_systems_that_one_table_lacks_are_others_there(make_run):
    """Table 2 has no Co-SLAM and Table 1 no Gaussian-SLAM; and nobody's runs are left out."""
    followed = make_run("box", "trajectory:passive?mapper=co_slam", psnr=11.0)
    followed.config["configuration"]["mapper"] = {"name": "co_slam"}
    planner = make_run("box", "splatam", psnr=99.0)  # somebody's policy that is called so
    mine = {"splatam": [["splatam", "active", "here"]], "co_slam": [[followed.policy, "passive", "here"]]}
    for table, others in ((REPLICA, mine["splatam"]), (MP3D, mine["co_slam"] + mine["splatam"])):
        found = rows(averages_table(table, Results([followed, planner], [])))
        assert [row[:3] for row in found if row[2] == "here"] == others


def test_the_report_has_them_when_asked(make_run, tmp_path):
    results = Results([make_run("box", "naruto")], [])
    for asked in (False, True):
        write_results(tmp_path / str(asked), results, published=asked)
    text = (tmp_path / "True" / PAGE).read_text()
    assert 'id="published"' in text and "Matterport3D, averages" in text
    assert 'id="published"' not in (tmp_path / "False" / PAGE).read_text()
    names = {table.name for table in published_tables(results)}
    assert len(names) == 4 and all((tmp_path / "True" / TABLES / f"{name}.tex").is_file() for name in names)
    assert "| NARUTO | active | published | 6 of Replica |" in markdown(published_tables(results)[0])
