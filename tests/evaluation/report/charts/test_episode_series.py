import numpy as np

from activestructure_gym.evaluation.report.charts import episode_series
from activestructure_gym.evaluation.report.charts.episode_series import Band, bands, chosen_terms
from activestructure_gym.evaluation.report.charts.history_chart import history_chart


def with_phases(steps):
    names = ["I scaffold"] * 2 + ["II objects"] * 3 + ["III post-refinement"]
    for step, name in zip(steps, names):
        step["trace"] = {"phase": name, "changed": None, "pool": 7, "chosen": dict(step["trace"], total=0.1)}
    steps[2]["trace"]["changed"] = "no view in the pool for 3 decisions"
    return steps


def test_bands_begin_with_the_decision_that_changed_the_phase(steps):
    assert bands(steps) == []
    assert bands(with_phases(steps)) == [
        Band("I scaffold", 1, 20),
        Band("II objects", 20, 50, "no view in the pool for 3 decisions"),
        Band("III post-refinement", 50, 60),
    ]


def test_what_follows_once_nothing_is_left_to_do_is_a_band_of_its_own(steps):
    steps = with_phases(steps)
    for step in steps[3:]:
        step["trace"]["phase"] = "III post-refinement"
        step["trace"]["settled"] = None
    steps[4]["trace"]["settled"] = steps[5]["trace"]["settled"] = "the worst keyframes have been revisited"
    assert bands(steps)[2:] == [
        Band("III post-refinement", 30, 40),
        Band("settled", 40, 60, "the worst keyframes have been revisited"),
    ]
    steps[4]["trace"]["settled"] = steps[5]["trace"]["settled"] = True  # without a reason
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


def test_a_long_episode_that_changes_its_phase_often_is_drawn(steps):
    template = with_phases(steps)[0]
    many = [
        {**template, "frames": 2 + number, "trace": {**template["trace"], "phase": f"{number // 5 % 3} phase"}}
        for number in range(70_000)
    ]
    assert len(bands(many)) == 14_000
    drawn = episode_series.drawn_steps(many)
    assert len(drawn) == 2001 and drawn[0] is many[0] and drawn[-1] is many[-1]
    assert episode_series.drawn_steps(steps) == steps and episode_series.drawn_steps([]) == []
    assert len(history_chart(drawn)) < 1_000_000
