import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import REFERENCE, Job, is_reference, policy_label, refuse_code
from activestructure_gym.evaluation.cli.options import split_policies
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.evaluation.running.episode import run_job
from activestructure_gym.evaluation.running.references import REFERENCES, reference_job
from activestructure_gym.policies import POLICIES, Policy, make_policy

SMALL = StandardProtocol(views=1, surface_samples=2000, points_source="means", view_width=64, view_height=36)


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_a_reference_is_no_policy_and_no_list_of_policies_has_it(name):
    assert not issubclass(REFERENCES[name], Policy)
    assert name not in POLICIES and name not in split_policies(["all"])
    for spec in (name, reference_job(name)):
        with pytest.raises(InputError):
            make_policy(spec)
    assert not any(is_reference(policy) for policy in POLICIES)
    assert "reference, sees the ground truth" in policy_label(reference_job(name))


def test_its_jobs_are_its_own_and_run_no_code_of_a_file():
    job = Job("box", reference_job("oracle"), 0)
    assert job.hash != Job("box", "oracle", 0).hash and job.policy == REFERENCE + "oracle"
    refuse_code([job], "a file")
    with pytest.raises(InputError, match="reference"):
        reference_job("orakel")


def test_a_comparison_keeps_references_and_policies_apart():
    jobs = [Job("box", "random", 0), Job("box", reference_job("oracle"), 0)]
    comparison = Comparison.of(jobs)
    assert comparison.policies == ("random",) and comparison.references == ("oracle",)


def test_it_sees_more_than_chance(tmp_path):
    size = {"sensor.width": 48, "sensor.height": 27}
    runs = [
        run_job(
            Job("box", who, 3, preset="fast", frame_budget=40, overrides=tuple(size.items()), protocol=SMALL),
            tmp_path / str(number),
        )
        for number, who in enumerate((reference_job("oracle"), "random"))
    ]
    oracle, chance = (run.metrics["metrics"]["observed_area"] for run in runs)
    assert oracle > chance
    assert runs[0].policy == "oracle (reference, sees the ground truth)"
