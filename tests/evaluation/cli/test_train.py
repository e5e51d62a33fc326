"""``asg train`` from outside: what is refused, what is written, what survives a SIGKILL."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.train.learning import _trusting
from activestructure_gym.evaluation.cli.train.methods import Bc, Ppo, Rank, training_config
from activestructure_gym.evaluation.training import reinforcement
from activestructure_gym.evaluation.training.config import TrainingConfig, WorldConfig
from activestructure_gym.policies.learned import SHIPPED
from activestructure_gym.policies.learned.checkpoint import save_checkpoint
from activestructure_gym.policies.learned.network import CandidateNetwork, NetworkConfig

TINY = [
    "--layouts", "2", "--frames", "20",
    "--set", "sensor.width=48", "sensor.height=27", "views.max_candidates=12", "mapper.iterations=0",
]  # fmt: skip
BOXES = ("box?seed=1", "box?seed=2&size=5,4,2.6")


@pytest.fixture(autouse=True)
def somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of this test's environment stays: the command caps the threads of its own process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "environ", os.environ.copy())


@pytest.fixture
def boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes in place of apartments, which take seconds to build."""
    from activestructure_gym.evaluation.training import scoring, training_env

    for module in (training_env, scoring):
        monkeypatch.setattr(module, "layout_specs", lambda use, count, rooms, lit=True: BOXES[:count])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["bc", "--teacher", "deep"], ["unknown feature 'deep'"]),
        (["bc", "--teacher", "gs_planner"], ["the columns gs_planner_volume, gs_planner_loss: give one as --teacher"]),
        (["bc", "--features", "pixle"], ["unknown feature 'pixle'", "did you mean 'pixel'"]),
        (["ppo", "--start", "nowhere"], ["not a checkpoint", "nowhere"]),
        (["ppo", "--gamma", "2"], ["gamma", "2"]),
        (["bc", "--episodes", "0"], ["episodes", "from 1 to"]),
        (["rank", "--preset", "quick"], ["unknown preset 'quick'"]),
        (["rank", "--workers", "-1"], ["--workers", "-1"]),
        (["ppo", "--resume"], ["--resume needs --out"]),
        (["ppo", "--resume", "--out", "nothing"], ["no training run", "nothing"]),
        (["eval", "--policies", "learned:nowhere"], ["not a checkpoint", "nowhere"]),
        (["eval", "--baselines", "hole_are"], ["unknown policy 'hole_are'"]),
        (["eval", "--policies", "pixel_only", "--baselines", "hole_area"], ["--baselines are among"]),
        (["bc", "--set", "sensor.depth_noise=redwood"], ["sensor.depth_noise", "--no-noise"]),
        (["bc", "--set", "features=pixel"], ["--features"]),
        (["bc", "--out", "foreign"], ["holds other files"]),
        (["eval", "--out", "foreign"], ["holds other files"]),
        (["eval", "--out", "foreign/thesis.tex"], ["is a file; give a directory"]),
        (["eval", "--scenes", "nowhere", "--dry-run"], ["unknown scene 'nowhere'"]),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(arguments, words, tmp_path, capsys) -> None:
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").touch()
    before = sorted(tmp_path.rglob("*"))
    assert main(["train", *arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("asg: ") and said.count("\n") == 1 and all(word in said for word in words), said
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("bc --epochs 7", "480 episodes of oracle, 7 epochs, on 240 layouts, 100 frames per episode"),
        (
            "ppo --frames 50 -o new",
            "40 iterations of 8 environments x 128 steps, on 240 layouts, 50 frames",
        ),
        ("ppo --workers 2 -o new", "preset fast, 8 processes, into new"),  # one per environment
        ("ppo --workers 1 -o new", "preset fast, 1 process, into new"),
        ("bc --workers 2 -o new", "preset fast, 2 processes, into new"),
        ("eval --scenes box --seeds 0-2 -o new", "4 policies x 27 episodes of 100 frames"),
    ],
)
def test_a_dry_run_says_what_would_run_and_writes_nothing(words, said, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", *words.split(), "--dry-run"]) == 0
    told = capsys.readouterr().out
    assert said in told and "into " in told and "nothing was run" in told and not list(tmp_path.iterdir())


def test_ppo_has_the_network_of_its_start(tmp_path: Path) -> None:
    features = ("unknown_volume", "unknown_volume_way")
    network = NetworkConfig(features, planes=16, rounds=1, use_planes=False)
    save_checkpoint(tmp_path / "small.safetensors", CandidateNetwork(network), {})
    assert training_config(Ppo(start="small")).network() == network
    save_checkpoint(tmp_path / "planes.safetensors", CandidateNetwork(NetworkConfig(features)), {})
    with pytest.raises(InputError, match="leave out --no-use-planes"):
        training_config(Ppo(start="planes", use_planes=False))


def test_a_killed_environment_is_told_in_one_sentence(boxes: None, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def killed(*arguments: object) -> None:
        raise EOFError

    monkeypatch.setattr(reinforcement, "train_ppo", killed)
    tiny = ["--preset", "rl", "--validation-layouts", "1", "--workers", "1", "--envs", "2", "--steps", "8", *TINY]
    assert main(["train", "ppo", "--out", "ppo", *tiny]) == 2
    said = capsys.readouterr().err
    assert "the process of an environment was killed" in said and "--resume" in said and "Traceback" not in said


@pytest.mark.parametrize(
    ("changes", "option"),
    [
        ({}, ""),
        ({"features": ("pixel", "mine:gain")}, " --trust-code"),
        ({"overrides": (("views.stages", (("mine:Source",),)),)}, " --trust-code"),
    ],
)
def test_the_command_that_goes_on_trusts_the_user_s_own_code(changes: dict[str, object], option: str) -> None:
    world = WorldConfig(**changes)  # type: ignore[arg-type]
    assert _trusting(TrainingConfig(world=world)) == option


def test_options_become_a_configuration() -> None:
    options = Rank(seed=3, rooms=(2,), features=("pixel,structure",), set=("sensor.width=64",), noise=False)
    config = training_config(options)
    assert training_config(Bc(temperature=0.1)).temperature == 0.1 and config.temperature == 0.04
    assert (config.method, config.seed, config.world.rooms, config.world.noise) == ("rank", 3, (2,), False)
    assert config.world.features == ("pixel", "structure") and config.world.overrides == (("sensor.width", 64),)
    listed = training_config(Bc(set=("views.heights_m=[0.0,0.4]",)))
    assert TrainingConfig.from_dict(json.loads(json.dumps(listed.as_dict()))) == listed
    with pytest.raises(InputError, match="those of --start: pixel, hole_area, .*, unknown_volume_way; got pixel"):
        training_config(Ppo(start=str(SHIPPED), features=("pixel,structure",)))
    assert set(training_config(Ppo(start=str(SHIPPED))).world.features) > {"pixel", "unknown_volume"}
    with pytest.raises(InputError, match="belongs to ppo"):
        TrainingConfig(method="bc", start="x")


def test_a_policy_that_fails_is_named_and_the_others_results_are_kept(
    boxes: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    text = (
        "from activestructure_gym.policies import Policy\n"
        "class Half(Policy):\n    def act(self, observation): return 3.7\n"
        "class Raises(Policy):\n    def act(self, observation): raise RuntimeError('boom')\n"
    )
    (tmp_path / "failing_policies.py").write_text(text)
    for name, words in (("Half", "act() must return a row"), ("Raises", "RuntimeError: boom")):
        score = ["train", "eval", "--out", name, "--policies", f"pixel_only,failing_policies:{name}", "--workers", "1"]
        assert main([*score, *TINY]) == 2
        said = capsys.readouterr().err.splitlines()
        assert len([line for line in said if line.startswith("asg: ")]) == 1 and words in said[-1]
        assert f"failing_policies:{name} on box" in said[-1]
        (log,) = (tmp_path / name / "logs").iterdir()
        assert words in log.read_text() and "Traceback" in log.read_text()
        (kept,) = (tmp_path / name / "episodes").iterdir()
        assert {"random", "pixel_only"} <= set(json.loads(kept.read_text()))


def test_from_nothing_to_a_table(boxes: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    learn = ["--episodes", "2", "--epochs", "2", "--validate-every", "1", "--validation-layouts", "2"]
    learn += ["--workers", "1", *TINY]
    assert main(["train", "bc", "--out", "bc", *learn]) == 0
    said = capsys.readouterr().out
    assert "normalised" in said and "learned:bc" in said
    description = json.loads((tmp_path / "bc" / "best.json").read_text())
    assert description["network"]["features"] == ["pixel", "hole_area"]
    assert description["trained"]["configuration"]["episodes"] == 2
    rows = [json.loads(line) for line in (tmp_path / "bc" / "log.jsonl").read_text().splitlines()]
    assert [row["unit"] for row in rows] == [1, 2] and all("validation/normalised" in row for row in rows)

    assert main(["train", "bc", "--out", "bc", *learn]) == 2
    assert "add --resume" in capsys.readouterr().err
    before = (tmp_path / "bc" / "last.safetensors").read_bytes()
    assert main(["train", "bc", "--out", "bc", "--resume"]) == 0  # it has ended; nothing changes
    assert (tmp_path / "bc" / "last.safetensors").read_bytes() == before
    capsys.readouterr()

    score = ["train", "eval", "--out", "score", "--policies", "pixel_only,learned:bc", "--workers", "1", *TINY]
    assert main(score) == 0
    said = capsys.readouterr().out
    assert "oracle-greedy" in said and "learned:bc/best" in said
    assert (tmp_path / "score" / "eval.md").read_text().count("`learned:bc/best`") == 1
    alone = ["learned:bc" if word == "pixel_only,learned:bc" else word for word in score]
    assert main(alone) == 0  # pixel_only does not play: no column for it
    assert (tmp_path / "score" / "eval.md").read_text().splitlines()[0].endswith("| normalised |")
    assert main([*score, "--baselines", "pixel_only,learned:bc"]) == 0  # nothing is played again
    head = (tmp_path / "score" / "eval.md").read_text().splitlines()[0]
    assert head.endswith("| normalised | minus pixel_only | minus learned:bc/best |")
    capsys.readouterr()
    assert main([*score, "--baselines", "pixel_only,random,hole_area"]) == 2
    assert "--baselines are among" in capsys.readouterr().err

    told = json.loads((tmp_path / "bc" / "timing.json").read_text())
    assert set(told["parts"]) == {"collecting", "updating", "validating"} and told["sittings"] == 2
    states = int(told["parts"]["updating"]["steps"]) // 2
    assert told["parts"]["collecting"]["steps"] == states > 0
    assert (tmp_path / "bc" / "curve.svg").read_text().startswith("<svg")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["bc", "ppo"])
def test_a_killed_run_goes_on_to_the_same_bytes(method: str, tmp_path: Path) -> None:
    small = ["--layouts", "2", "--rooms", "1", "--frames", "12", "--validation-layouts", "1", "--workers", "2"]
    small += ["--set", "views.max_candidates=12", "sensor.width=48", "sensor.height=27", "mapper.iterations=0"]
    ppo = ["--iterations", "3", "--steps", "32", "--envs", "2"]
    small += ["--episodes", "10", "--epochs", "40"] if method == "bc" else ppo
    small += ["--validate-every", "20"]
    command = [sys.executable, "-m", "activestructure_gym.evaluation.cli", "train", method]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    whole = subprocess.run([*command, "--out", "whole", *small], env=environment, capture_output=True, text=True)
    assert whole.returncode == 0, whole.stderr
    process = subprocess.Popen([*command, "--out", "killed", *small], env=environment)
    log = tmp_path / "killed" / "log.jsonl"
    while process.poll() is None and not (log.is_file() and log.read_text().count("\n") >= 2):
        time.sleep(0.02)
    assert process.poll() is None, "it ended before it could be killed"
    process.send_signal(signal.SIGKILL)
    process.wait()
    again = subprocess.run([*command, "--out", "killed", "--resume"], env=environment, capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert "going on" in again.stdout
    for name in ("last.safetensors", "best.safetensors", "log.jsonl"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_rl_has_features_of_the_volume_and_says_the_expected_time(boxes: None, tmp_path: Path, capsys) -> None:
    assert training_config(Ppo(preset="rl")).world.features == ("unknown_volume",)
    assert training_config(Ppo(set=("mapper.enabled=false",))).world.features == ("unknown_volume",)
    assert training_config(Ppo()).world.features == ("pixel", "hole_area")
    assert main(["train", "ppo", "--preset", "rl", "--features", "pixel", "--out", "no"]) == 2
    assert "'pixel' reads the map, which is empty" in capsys.readouterr().err
    assert main(["train", "eval", "--preset", "rl", "--policies", "pixel_only", "--out", "no"]) == 2
    assert "'pixel' reads the map, which is empty" in capsys.readouterr().err and not (tmp_path / "no").exists()

    tiny = ["--preset", "rl", "--validation-layouts", "1", "--workers", "1", *TINY]
    assert main(["train", "bc", "--out", "bc", "--episodes", "2", "--epochs", "1", *tiny]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^expected: \d+\.\d minutes, \d+\.\d processor minutes", said, re.MULTILINE)
    ppo = ["--start", "bc", "--iterations", "1", "--envs", "2", "--steps", "8", "--out", "ppo"]
    assert main(["train", "ppo", *ppo, *tiny]) == 0
    assert capsys.readouterr().out.index("expected: ") == 0
    description = json.loads((tmp_path / "ppo" / "last.json").read_text())
    assert description["network"]["features"] == ["unknown_volume", "unknown_volume_way"]
    score = ["--preset", "rl", "--workers", "1", "--policies", "learned:ppo/last", "--out", "score", *TINY]
    assert main(["train", "eval", *score]) == 0 and "learned:ppo/last" in capsys.readouterr().out
