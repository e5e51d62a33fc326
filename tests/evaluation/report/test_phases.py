import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from activestructure_gym.evaluation.report import phases
from activestructure_gym.evaluation.report.phases import Band, bands, chosen_terms, plot_phases


def with_phases(steps):
    names = ["I scaffold"] * 2 + ["II objects"] * 3 + ["III post-refinement"]
    for step, name in zip(steps, names):
        step["trace"] = {"phase": name, "changed": None, "pool": 7, "chosen": dict(step["trace"], total=0.1)}
    steps[2]["trace"]["changed"] = "no view in the pool for 3 decisions"
    return steps


def pixels(path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int).reshape(-1, 3)


def tinted(path, index: int) -> int:
    colour = np.array(to_rgb(phases._TINTS[index])) * 255
    return int((np.abs(pixels(path) - colour).max(axis=1) < 2).sum())


def test_bands_begin_with_the_decision_that_changed_the_phase(steps):
    assert bands(with_phases(steps)) == [
        Band("I scaffold", 1, 20),
        Band("II objects", 20, 50, "no view in the pool for 3 decisions"),
        Band("III post-refinement", 50, 60),
    ]


def test_what_follows_once_nothing_is_left_to_do_is_a_band_of_its_own(steps, tmp_path):
    steps = with_phases(steps)
    for step in steps[3:]:
        step["trace"]["phase"] = "III post-refinement"
        step["trace"]["settled"] = None
    steps[4]["trace"]["settled"] = steps[5]["trace"]["settled"] = "no keyframe left to revisit"
    assert bands(steps)[2:] == [
        Band("III post-refinement", 30, 40),
        Band("settled", 40, 60, "no keyframe left to revisit"),
    ]
    plot_phases([("", steps)], tmp_path / "settled.png", title="title")
    assert tinted(tmp_path / "settled.png", 3) > 1000
    steps[4]["trace"]["settled"] = steps[5]["trace"]["settled"] = True  # of a run before reasons were told
    assert bands(steps)[-1] == Band("settled", 40, 60)


def test_terms_are_those_of_the_choice_or_of_the_whole_trace(steps):
    plain = chosen_terms(steps)
    np.testing.assert_allclose(plain["pixel"], 0.5 / np.arange(1, 7))
    assert set(plain) == {"pixel", "travel"}
    steps = with_phases(steps)
    del steps[3]["trace"]["chosen"]["total"]
    terms = chosen_terms(steps)
    assert set(terms) == {"pixel", "travel", "total"}  # neither the phase nor the size of the pool
    np.testing.assert_array_equal(np.isnan(terms["total"]), [False, False, False, True, False, False])


def test_a_policy_without_phases_has_curves_and_no_bands(steps, tmp_path):
    assert bands(steps) == []
    plot_phases([("", steps)], tmp_path / "plain.png", title="title")
    assert tinted(tmp_path / "plain.png", 1) == 0
    found = np.abs(pixels(tmp_path / "plain.png") - phases.style.STRUCTURAL).max(axis=1) < 8
    assert found.sum() > 200


def test_phases_are_tinted_by_their_length(steps, tmp_path):
    plot_phases([("", with_phases(steps))], tmp_path / "phases.png", title="title")
    first, second, third = (tinted(tmp_path / "phases.png", index) for index in range(3))
    assert second > first > third > 1000


@pytest.mark.parametrize("changed", [{}, {"graph": {"deficit": None, "deficiency_area": 0.0}, "trace": {}}])
def test_runs_with_few_numbers_can_be_drawn(steps, tmp_path, changed):
    bare = [{"frames": step["frames"], **changed} for step in steps]
    plot_phases([("a", bare), ("b", steps), ("c", [])], tmp_path / "x.png", title="title", gains=False)
    plot_phases([("", bare)], tmp_path / "x.png", title="title")
    plot_phases([("", [])], tmp_path / "x.png", title="title")
    assert len(pixels(tmp_path / "x.png"))


def test_a_dollar_is_a_dollar(steps, tmp_path):
    for step, phase in zip(steps, ("$\\frac{", "b", "b", "c", "c", "c")):
        step["trace"] |= {"phase": phase, "changed": "it costs 3 $_"}
    plot_phases([("", steps)], tmp_path / "phases.png", title="$\\nothing_")
    assert (tmp_path / "phases.png").is_file()


def test_a_long_episode_that_changes_its_phase_often_is_drawn(steps, tmp_path):
    template = with_phases(steps)[0]
    many = [
        {**template, "frames": 2 + number, "trace": {**template["trace"], "phase": f"{number // 5 % 3} phase"}}
        for number in range(70_000)
    ]
    assert len(bands(many)) == 14_000
    drawn = phases.drawn_steps(many)
    assert len(drawn) == 2001 and drawn[0] is many[0] and drawn[-1] is many[-1]
    assert phases.drawn_steps(steps) == steps and phases.drawn_steps([]) == []
    plot_phases([("", many)], tmp_path / "long.png", title="title")  # a layout without room warns, which is an error
    assert all(tinted(tmp_path / "long.png", index) > 1000 for index in range(2))
