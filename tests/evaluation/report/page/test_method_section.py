"""The method section names the configuration of every policy."""

from activestructure_gym.evaluation.report.page.method_section import _configuration


def test_every_policy_is_named_with_its_value_of_a_field_that_differs(make_run):
    runs = [make_run(policy=policy, seed=seed) for policy in "abc" for seed in range(2)]
    for run in runs:
        run.config["configuration"]["mapper"] = {"iterations": 8 if run.policy == "c" else 5, "name": "default"}
    texts = {name.text: value.text for name, value in _configuration(runs).rows}
    assert texts["mapper.iterations"] == "a, b: 5; c: 8" and texts["mapper.name"] == "default"
