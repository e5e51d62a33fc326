import copy
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.envs import ReconstructionEnv
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import REFERENCE, Job, policy_label, refuse_code
from activestructure_gym.evaluation.cli.options import split_policies
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.protocols.held_out_views import posed_views
from activestructure_gym.evaluation.references import oracles
from activestructure_gym.evaluation.references.oracles import REFERENCES, WHOLE_POOL, make_reference, reference_job
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.evaluation.running.episode import run_job
from activestructure_gym.geometry import PinholeCamera, transform_points
from activestructure_gym.ground_truth import ground_truth_of
from activestructure_gym.policies import POLICIES, Policy, make_policy
from activestructure_gym.scenes import load_scene
from activestructure_gym.specs import Spec

SMALL = StandardProtocol(views=1, surface_samples=2000, points_source="means", view_width=64, view_height=36)


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_a_reference_is_no_policy_and_no_list_of_policies_has_it(name):
    assert not issubclass(REFERENCES[name], Policy)
    assert name not in POLICIES and name not in split_policies(["all"])
    for spec in (name, reference_job(name)):
        with pytest.raises(InputError):
            make_policy(spec)
    assert not any(Spec(policy).kind == "reference" for policy in POLICIES)
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
            Job(
                "box",
                who,
                3,
                conditions=Conditions(preset="fast", frame_budget=40, overrides=tuple(size.items()), protocol=SMALL),
            ),
            tmp_path / str(number),
        )
        for number, who in enumerate((reference_job("oracle"), "random"))
    ]
    oracle, chance = (run.metrics["metrics"]["observed_area"] for run in runs)
    assert oracle > chance
    assert runs[0].policy == "oracle (reference, sees the ground truth)"


@pytest.fixture(scope="module")
def refining():
    """A box of which everything was seen, half of the frames spent: env and truth."""
    truth = ground_truth_of(load_scene("box"))
    config = {"sensor": {"width": 64, "height": 36}, "views.max_candidates": WHOLE_POOL}
    env = ReconstructionEnv(truth, preset="fast", frame_budget=200, features=(), config=config, coverage_target=None)
    env.reset(seed=3)
    while env.reconstruction.frames < 100:
        env.step(0)
    yield env, truth
    env.close()


@pytest.mark.parametrize("target", [1, 3])
def test_quality_takes_the_view_that_truly_mends_the_map(refining, monkeypatch, target):
    env, truth = refining
    now = env.reconstruction
    monkeypatch.setattr(oracles, "_SHORTLIST", 3)
    reference = make_reference(reference_job("oracle-quality"), env, truth, SMALL)
    reference.reset(0)
    # The one held-out view is the target's own, and what the map shows there has the wrong colour.
    pose = now.candidates.world_from_camera[target]
    view = posed_views(truth.scene, pose[None], camera=PinholeCamera.from_size(64, 36, 60.0), supersample=1)
    reference._quality._truth = replace(reference._quality._truth, views=view)
    gaussians = now.mapper.map
    kept = gaussians.parameters.copy()
    x, y, z = transform_points(np.linalg.inv(pose), gaussians.means).T
    gaussians.parameters[11:14, : gaussians.count][:, (z > 0) & (abs(x) < 0.6 * z) & (abs(y) < 0.35 * z)] = 0.0
    painted, state = gaussians.parameters.copy(), copy.deepcopy(now.mapper._rng.bit_generator.state)
    try:
        row = reference.act({})
        np.testing.assert_array_equal(gaussians.parameters, painted)
        assert now.mapper._rng.bit_generator.state == state
        taken = now.agent.paths(now.volume, now.candidates.world_from_camera)
        mapped = reference._shortlist()
        every = reference._quality.changes(now, {k: way for k, way in enumerate(taken) if way is not None})
        gains = {k: change["psnr"] for k, change in every.items()}
        assert len(every) > len(mapped) == 3
        assert row == max(gains, key=gains.get) and reference.trace()["psnr_per_100"] == gains[row] > 0
    finally:
        gaussians.parameters[:] = kept
