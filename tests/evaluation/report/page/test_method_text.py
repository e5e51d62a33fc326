"""Sentences on missing numbers name every protocol that lacks them."""

from dataclasses import replace

import pytest

from activestructure_gym.evaluation.report.page.document import html_page
from activestructure_gym.evaluation.report.page.method_text import (
    machine_text,
    missing_value_texts,
    native_setup_text,
    protocol_texts,
)
from activestructure_gym.evaluation.report.results import Results
from activestructure_gym.evaluation.report.tables.published import published_tables


def test_a_reason_of_two_protocols_is_given_once_with_both_names(make_run):
    notes = {"lpips": "no weights"}
    run = make_run(lpips=None, notes=notes)
    run.protocols["activegamer"] = {
        "parameters": {"name": "activegamer"},
        "metrics": {"psnr": 30.0, "lpips": None, "notes": notes},
    }
    texts = missing_value_texts(Results([run], []))
    assert "Protocols standard and activegamer: LPIPS is left out: no weights." in texts


def test_every_further_protocol_of_this_package_is_described(make_run):
    run = make_run()
    for name in ("activegamer", "offline"):
        run.protocols[name] = {"parameters": {"name": name}, "metrics": {"notes": {}}}
    texts = protocol_texts(Results([run], []))
    assert [text.split("`")[1] for text in texts] == ["standard", "activegamer", "offline"]


def test_a_protocol_that_only_a_later_run_has_is_described(make_run):
    first, second = make_run(), make_run(seed=1)
    second.protocols["offline"] = {"parameters": {"name": "offline"}, "metrics": {"notes": {"lpips": "no weights"}}}
    results = Results([first, second], [])
    assert [*results.protocols] == ["standard", "offline"] and results.protocols["standard"] is not None
    assert "`offline`" in protocol_texts(results)[-1] and len(protocol_texts(results)) == 2
    assert missing_value_texts(results) == ["Protocol offline: LPIPS is left out: no weights."]


@pytest.fixture
def swept_runs(make_run):
    runs = [make_run(policy="naruto", swept={"sensor.width": width}) for width in (96, 160)]
    for run, width, budget in zip(runs, (96, 160), (200, 100)):
        sensor = run.config["configuration"]["sensor"] | {"width": width}
        run.config["configuration"] |= {"sensor": sensor, "frame_budget": budget}
    return runs


def test_texts_name_every_sensor_and_budget_of_a_sweep(swept_runs):
    results = Results(swept_runs, [])
    assert "sensor 96 x 54 or 160 x 54 pixels, depth noise none." in machine_text(results)
    assert "200 or 100 frames each" in html_page(results)
    assert "200 or 100 frames of 96 x 54 or 160 x 54 pixels, protocol" in published_tables(results)[0].caption


def test_a_swept_policy_of_the_native_setup_keeps_the_budget_of_its_paper(swept_runs):
    runs = []
    for run in swept_runs:
        job = replace(run.job, conditions=replace(run.job.conditions, setup="native"))
        more = {
            "views": {"stages": [["pool"]], "max_candidates": 8}, "motion": {"candidate_clearance": 0.3},
            "mapper": {"name": "default", "iterations": 5}, "keyframe_every": 5,
        }  # fmt: skip
        runs.append(replace(run, job=job, config=run.config | {"configuration": run.config["configuration"] | more}))
    (text,) = native_setup_text(Results(runs, []))
    assert "`naruto [sensor.width=96]` up to 8 views" in text and text.count("a keyframe every 5 frames (") == 2
