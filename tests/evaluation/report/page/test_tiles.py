import re

import numpy as np
import pytest

from activestructure_gym.evaluation.report.page.tiles import Tiles, plan_tile, planes_tile, views_strip


@pytest.fixture
def tiles():
    return Tiles(["b", "a"], frozenset("ab"))


def alts(markup):
    return re.findall(r'alt="([^"]*)"', markup)


def test_a_view_says_how_far_it_is_from_the_best(make_run, tiles):
    runs = [make_run(policy="a"), make_run(policy="b")]
    runs[0].pictures["psnr"] = np.array([20.0, 21.0, 22.0, 23.0])
    runs[1].pictures["psnr"] = np.array([20.0, 19.5, 24.25, 23.0])
    truth, a, b = views_strip(runs, tiles)
    assert (truth["index"], a["index"], b["index"]) == (None, 1, 0)
    said = [alts(view["picture"])[0] for view in (*a["views"], *b["views"])]
    assert said[1] == "view 2 rendered from the map of a, PSNR 21.00 dB: the best"
    assert said[2] == "view 3 rendered from the map of a, PSNR 22.00 dB: 2.25 dB below b"
    assert said[5] == "view 2 rendered from the map of b, PSNR 19.50 dB: 1.50 dB below a"
    assert said[0].endswith("the best") and said[4].endswith("the best")  # equal
    alone = views_strip(runs[:1], tiles)[1]["views"]
    assert alts(alone[0]["picture"]) == ["view 1 rendered from the map of a, PSNR 20.00 dB"] and not alone[0]["best"]


def test_the_best_view_is_a_planners(make_run, tiles):
    runs = [make_run(policy="a"), make_run(policy="reference:oracle"), make_run(policy="b")]
    for run, psnr in zip(runs, (20.0, 30.0, 19.0)):
        run.pictures["psnr"] = np.full(4, psnr)
    tiles = Tiles([run.policy for run in runs], frozenset())
    _, a, oracle, b = views_strip(runs, tiles)
    assert [row["views"][0]["best"] for row in (a, oracle, b)] == [True, False, False]
    assert alts(oracle["views"][0]["picture"])[0].endswith("10.00 dB above a")
    assert alts(b["views"][0]["picture"])[0].endswith("1.00 dB below a")


def test_a_plan_says_how_much_of_it_was_looked_into(make_run, tiles):
    run = make_run(policy="a")
    run.pictures["plan_state"] = np.repeat(np.array([[0], [1], [2], [1]], np.uint8), 10, axis=1)
    tile = plan_tile(run, tiles)
    assert tile["caption"].startswith("75 % of the plan") and tile["caption"] in alts(tile["picture"])[0]


def test_planes_say_what_they_lack(make_run, tiles):
    run = make_run(policy="a", planes=True)  # areas 11.91 and 2.00, deficits 0 and 0.05
    tile = planes_tile(run, tiles)
    assert tile["by_deficit"]["caption"] == (
        "1 deficiency centre with 0.1 m² of deficient surface; planes with a deficit of at least 0.01 have "
        "14 % of the planes' area"
    )
    assert len(tile["pictures"]) == 3 and tile["caption"].endswith(
        "1 structural planes, 1 object planes, 1 deficiency centre with 0.1 m²"
    )
    assert planes_tile(run, Tiles(["a"], frozenset()))["pictures"] == []
