import pytest

from activestructure_gym.evaluation.report.page.answer import answer, answer_text
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.verdicts import leads


def made(make_run, seeds, **psnr):
    """Results of policies with equal metrics except the PSNR, by seed."""
    runs = [make_run("room", policy, seed, psnr=psnr[policy] + 0.1 * seed) for policy in psnr for seed in range(seeds)]
    return Results(runs, [])


@pytest.mark.parametrize(
    ("seeds", "psnr", "text"),
    [
        (6, {"a": 20.0, "b": 22.0}, "b is best in 1 of 2 metrics. The lead is significant (95 %)."),
        (
            2,
            {"a": 20.0, "b": 22.0},
            "b is best in 1 of 2 metrics. The lead is significant (95 %), at least 2 pairs.",
        ),
        (2, {"a": 20.0, "b": 20.0}, "The best policies are equal in all metrics."),
        (
            1,
            {"a": 23.0, "b": 22.0},
            "a is best in 1 of 2 metrics. One seed gives no intervals, so no lead is certain.",
        ),
        (1, {"a": 23.0}, ""),
    ],
)
def test_the_sentence_names_the_best_and_says_whether_it_is_sure(make_run, seeds, psnr, text):
    results = made(make_run, seeds, **psnr)
    assert answer_text(results, leads(results)) == text


def test_of_several_winners_the_most_frequent_is_first(make_run):
    numbers = {"a": {"psnr": 25.0}, "b": {"observed": 70.0, "completion_ratio": 85.0}, "c": {}}
    runs = [
        make_run("room", policy, seed, **{"observed": 60.0, **own})
        for policy, own in numbers.items()
        for seed in (0, 1)
    ]
    results = Results(runs, [])
    text = "b is best in 2 of 3 metrics, a in 1. All 3 leads are significant (95 %), at least 2 pairs."
    assert answer_text(results, leads(results)) == text


@pytest.mark.parametrize(
    ("lead", "text"),
    [
        # One seed is 3 dB for b and the other 1 dB for a: the interval of the mean contains 0.
        ((3.0, -1.0), "No policy is clearly best: no lead is significant (95 %), at least 2 pairs. {}"),
        ((3.0, 3.0), "{} Of 2 leads, 1 is significant (95 %), at least 2 pairs."),
    ],
)
def test_policies_with_as_many_metrics_are_named_together(make_run, lead, text):
    runs = [
        make_run("room", policy, seed, psnr=20.0 + lead[seed] * (policy == "b"), observed=60.0 + mine[seed])
        for policy, mine in (("a", (9.0, -5.0)), ("b", (0.0, 0.0)))
        for seed in (0, 1)
    ]
    results = Results(runs, [])
    assert answer_text(results, leads(results)) == text.format("a and b are each best in 1 of 3 metrics.")


def test_many_policies_with_as_many_metrics_are_counted(make_run):
    best = {"a": "psnr", "b": "observed", "c": "completion_ratio", "d": "observed_area"}
    usual = {"psnr": 20.0, "observed": 60.0, "completion_ratio": 70.0, "observed_area": 50.0}
    runs = [make_run("room", policy, 0, **usual | {key: usual[key] + 5.0}) for policy, key in best.items()]
    results = Results(runs, [])
    assert answer_text(results, leads(results)).startswith("4 policies are each best in 1 of 4 metrics. One seed gives")
    # With two seeds, each lead is +5 and -4: none is significant, and the cards name the policies.
    runs += [make_run("room", policy, 1, **usual | {key: usual[key] - 4.0}) for policy, key in best.items()]
    results = Results(runs, [])
    text = "No policy is clearly best: no lead is significant (95 %), at least 2 pairs."
    assert answer_text(results, leads(results)) == text


def test_a_card_has_value_winner_lead_and_verdict(make_run):
    text = answer(made(make_run, 6, a=20.0, b=22.0))
    card = text[text.index('<span class="metric">PSNR</span>') :]
    assert "<strong>22.25<small> dB</small></strong>" in card and "</i>b</span>" in card
    assert '<span class="ahead">+2.00 [+2.00, +2.00] against a</span>' in card
    assert '<span class="badge good">better (95 %)</span>' in card
    assert "equal as printed" in text[: text.index('<span class="metric">PSNR</span>')]  # of C.R.


def test_a_failed_run_makes_no_winner(make_run):
    """A's hardest seed failed: by the seeds that both have, B is better."""
    ratios = {"a": (90.0, 90.2), "b": (91.0, 91.3, 60.0)}
    runs = [
        make_run("room", policy, seed, completion_ratio=ratio, psnr=0.2 * ratio)
        for policy, own in ratios.items()
        for seed, ratio in enumerate(own)
    ]
    results = Results(runs, [])
    first = leads(results)[0]
    assert (first.policy, first.runner_up, first.mean.runs) == ("b", "a", 2) and first.margin.difference.value > 0
    assert answer_text(results, leads(results)).startswith("b is best in all 2 metrics.")


def test_who_was_not_on_every_scene_is_named(make_run):
    runs = [
        make_run(scene, policy, seed, psnr=20.0 + 10.0 * (policy == "a"))
        for scene in ("one", "two")
        for policy in "abc"
        for seed in (0, 1)
        if (scene, policy) != ("two", "a")
    ]
    results = Results(runs, [])
    text = "The best policies are equal in all metrics. Without a run on every scene, so not compared: a."
    assert answer_text(results, leads(results)) == text


@pytest.mark.parametrize(
    ("seeds", "text"),
    [
        # The baseline has one seed, the best two have six.
        ({"random": (0,), "a": range(6), "b": range(6)}, "The lead is significant (95 %)."),
        # The best two share one seed, each shares several with the baseline.
        (
            {"random": range(6), "a": (2, 4, 5), "b": (0, 1, 2)},
            "A single pair on a scene gives no intervals, so no lead is certain.",
        ),
    ],
)
def test_what_is_said_of_leads_does_not_depend_on_the_baseline(make_run, seeds, text):
    runs = [
        make_run("room", policy, seed, psnr={"random": 10.0, "a": 20.0, "b": 22.0}[policy] + 0.1 * seed)
        for policy, own in seeds.items()
        for seed in own
    ]
    results = Results(runs, [], "random")
    assert answer_text(results, leads(results)) == f"b is best in 1 of 2 metrics. {text}"
