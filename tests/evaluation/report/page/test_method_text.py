"""Sentences on missing numbers name every protocol that lacks them."""

from activestructure_gym.evaluation.report.page.method_text import missing_value_texts, protocol_texts
from activestructure_gym.evaluation.report.results import Results


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
