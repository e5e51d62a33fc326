"""Checkpoints as policies of a comparison: named by place and content, and run like any other."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest
import torch

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.completion import is_done
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job, policy_label
from activestructure_gym.evaluation.archive.store import read_run
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running import comparison
from activestructure_gym.evaluation.running.actors import build
from activestructure_gym.policies import POLICIES, canonical_policy, make_policy
from activestructure_gym.policies.learned import learned_from
from activestructure_gym.policies.learned.checkpoint import save_checkpoint
from activestructure_gym.policies.learned.config import NetworkConfig
from activestructure_gym.policies.learned.network import CandidateNetwork
from activestructure_gym.specs import Spec
from tests.evaluation.written_runs import write_run


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A training run's directory, and the working directory above it."""
    torch.manual_seed(0)
    place = tmp_path / ("a_long_name_" * 8) / "run"
    save_checkpoint(place / "best.safetensors", CandidateNetwork(NetworkConfig(features=("structure",))), {})
    monkeypatch.chdir(place.parent)
    return place


def test_a_job_knows_the_checkpoint_from_anywhere_and_its_content(run: Path, monkeypatch) -> None:
    spec = canonical_policy("learned:run")
    assert spec.startswith(f"learned:{run}/best.safetensors@")
    monkeypatch.chdir("/")
    assert canonical_policy(spec) == spec
    first = Job(scene="box", policy=spec, seed=0)
    assert len(first.name.encode()) < 200
    save_checkpoint(run / "best.safetensors", CandidateNetwork(NetworkConfig(features=("structure",))), {})
    with pytest.raises(InputError, match="has changed"):
        canonical_policy(spec)
    assert Job(scene="box", policy=canonical_policy(f"learned:{run}"), seed=0).name != first.name
    assert canonical_policy("pixel_only") == "pixel_only"
    with pytest.raises(InputError, match="takes no options"):
        canonical_policy(f"learned:{run}?travel=shared")


def test_tables_show_a_short_name_that_tells_contents_apart(run: Path) -> None:
    spec = canonical_policy("learned:run")
    digits = spec[-8:]
    assert policy_label(spec) == f"learned:run@{digits}"
    assert policy_label(Spec(spec.replace("best.", "last."))) == f"learned:last@{digits}"
    for name in ("pixel_only", "learned", "active_gs?travel=shared", "module:Class"):
        assert policy_label(Spec(name)) == name
    job = Job(scene="box", policy=spec, seed=0)
    assert job.title == f"box · learned:run@{digits} · seed 0"


def test_a_finished_run_is_read_with_that_name(run: Path, tmp_path: Path) -> None:
    job = Job(scene="box", policy=canonical_policy("learned:run"), seed=0)
    place = tmp_path / job.name
    read = read_run(write_run(place, job))
    assert read.policy == policy_label(job.policy) and read.job == job and is_done(place, read.job)


def test_a_question_mark_in_a_path_is_told(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = run.parent / "what?really"
    run.rename(asked)
    with pytest.raises(InputError, match=r"'what\?really' is there: a checkpoint's path may hold no '\?'"):
        make_policy(f"learned:{asked}")
    with pytest.raises(InputError, match="may hold no"):
        learned_from(str(asked))
    monkeypatch.chdir(asked)  # absolute names are kept, and would not be found again
    with pytest.raises(InputError, match="may hold no"):
        canonical_policy("learned:best")


def test_a_class_derived_from_a_checkpoint_s_is_another_policy(run: Path, monkeypatch) -> None:
    kind = learned_from("run")
    monkeypatch.setitem(POLICIES._entries, "mine", type("Mine", (kind,), {}))
    assert canonical_policy("mine") == "mine" != kind.spec


def test_a_checkpoint_spelt_in_two_ways_runs_once(run: Path, monkeypatch) -> None:
    warmed = []
    monkeypatch.setattr(comparison, "warming_up", lambda policies, *_: warmed.append(policies) or nullcontext())
    monkeypatch.setattr(StandardProtocol, "truth", lambda self, scene: None)
    specs = ["learned:run", f"learned:{run / 'best.safetensors'}", "random"]
    jobs = comparison.Comparison(["box"], specs, conditions=Conditions(preset="fast")).prepare()
    assert [job.policy for job in jobs] == [canonical_policy("learned:run"), "random"] == warmed[0]
    assert comparison.Comparison.of(jobs).policies == tuple(warmed[0])


def test_its_env_offers_the_gains_of_the_checkpoint(run: Path) -> None:
    from activestructure_gym.scenes import load_scene

    job = Job(
        scene="box",
        policy=canonical_policy("learned:run"),
        seed=0,
        conditions=Conditions(preset="fast", frame_budget=10),
    )
    policy, env = build(job, load_scene("box"))
    assert env.config.features == ("structure",)
    observation, _ = env.reset(seed=0)
    policy.reset(0)
    assert observation["action_mask"][policy.act(observation)] == 1
    env.close()
