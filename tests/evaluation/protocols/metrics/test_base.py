"""A metric of one's own: computed, or None with its reason; never in the way of a finished run."""

import math
from types import SimpleNamespace

import pytest

from activestructure_gym.errors import InputError, InputWarning
from activestructure_gym.evaluation.protocols.metrics import METRICS, Metric, get_metric, get_metrics, measure_metrics


@pytest.fixture
def own(monkeypatch):
    """Register metrics of these functions, and return their names."""

    def register(**functions):
        for name, compute in functions.items():
            monkeypatch.setitem(METRICS._entries, name, Metric(f"my_{name}", best="highest", compute=compute))
        return tuple(functions)

    monkeypatch.setattr(METRICS, "_entries", dict(METRICS._entries))
    return register


def test_what_is_no_number_is_none_and_has_its_reason(own):
    names = own(
        half=lambda context: context.numbers["frames"] / 2,
        nothing=lambda context: None,
        endless=lambda context: math.inf,
        broken=lambda context: context.no_such_field,
    )
    values, described = measure_metrics(names, SimpleNamespace(numbers={"frames": 3}))
    assert values == {"my_half": 1.5, "my_nothing": None, "my_endless": None, "my_broken": None}
    assert [one.get("reason") for one in described] == [
        None,
        "it is not defined for this map",
        "its value is inf",
        "AttributeError: 'types.SimpleNamespace' object has no attribute 'no_such_field'",
    ]
    assert Metric.from_dict(described[0]) == Metric("my_half", best="highest")


def test_a_number_of_the_run_is_not_replaced(own):
    names = own(views=lambda context: 1.0, half=lambda context: 0.5)
    with pytest.warns(InputWarning, match="metric 'my_.*' is left out, since the run has another number"):
        values, described = measure_metrics((*names, "half"), SimpleNamespace(numbers={"my_views": []}))
    assert values == {"my_half": 0.5} and [one["name"] for one in described] == ["my_half"]


def test_the_label_is_the_name_where_none_is_given():
    assert Metric("far_cm", best="lowest").label == "far_cm"
    assert Metric("far_cm", best="lowest", label="far").label == "far"


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"name": "Far away", "best": "lowest"}, "lower-case letters, digits and underscores, got 'Far away'"),
        ({"name": "far", "best": "up"}, "best of the metric 'far' is lowest or highest, got 'up'"),
        ({"name": "far", "best": "lowest", "digits": 2.5}, "digits of the metric 'far' is a whole number from 0 to 12"),
    ],
)
def test_a_metric_that_no_table_could_show_is_refused(fields, message):
    with pytest.raises(InputError, match=message):
        Metric(**fields)


def test_names_that_cannot_be_asked_for(own, monkeypatch):
    with pytest.raises(InputError, match="unknown metric 'psnrr'; did you mean 'psnr'"):
        get_metric("psnrr")
    with pytest.raises(InputError, match="every run has the metric 'psnr' already: leave it out"):
        get_metric("psnr")
    monkeypatch.setitem(METRICS._entries, "mine", Metric("psnr", best="highest", compute=lambda context: 1.0))
    with pytest.raises(InputError, match="metric 'mine' is called 'psnr', which is another metric: rename it"):
        get_metric("mine")


def test_two_metrics_with_one_key_are_refused_and_one_under_two_names_is_measured_once(own, monkeypatch):
    first, twin = (Metric("far", best="lowest", compute=lambda context: 1.0) for _ in range(2))
    for name, metric in {"a": first, "b": first, "c": twin}.items():
        monkeypatch.setitem(METRICS._entries, name, metric)
    assert get_metrics(["a", "b"]) == [first]
    with pytest.raises(InputError, match="metrics 'a' and 'c' are both called 'far': rename one of them"):
        get_metrics(["a", "b", "c"])
