"""What stands beside a run's results: the picture of its log, its times, and TensorBoard's copy."""

from __future__ import annotations

import json
import re
import sys
import types
import xml.etree.ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.machine.processes import processor_seconds
from activestructure_gym.evaluation.training import stopwatch
from activestructure_gym.evaluation.training.config import TrainingConfig
from activestructure_gym.evaluation.training.curve import learning_curve
from activestructure_gym.evaluation.training.runs import (
    SCORE,
    STATE,
    TrainingRun,
    module_tensors,
    optimizer_tensors,
    read_config,
)
from activestructure_gym.policies.learned.network import CandidateNetwork

CONFIG = TrainingConfig(method="bc", epochs=3, planes=8, candidates=16)


def finish(run: TrainingRun, loss: float) -> None:
    torch.manual_seed(0)
    row = {"train/loss": loss, SCORE: loss, "validation/normalised": 1 - loss}
    run.finish_unit(row, CandidateNetwork(CONFIG.network()), {"module.x": torch.zeros(1)})


def curves(picture: str) -> list[str]:
    """The paths of the charts' curves; those of the legend are left out."""
    drawn = [
        path.get("d", "") for path in xml.etree.ElementTree.fromstring(picture).iter() if path.get("class") == "curve"
    ]
    return [path for path in drawn if not path.startswith("M1 7")]


def test_the_picture_grows_with_the_log(tmp_path: Path) -> None:
    run = TrainingRun(tmp_path, CONFIG)
    for number, loss in enumerate((0.9, 0.5, 0.25), start=1):
        finish(run, loss)
        picture = (tmp_path / "curve.svg").read_text()
        drawn = curves(picture)
        # A move to the first point, then steps from point to point.
        steps = [np.array(re.findall(r"-?\d*\.?\d+", path), float).reshape(-1, 2) for path in drawn]
        assert [len(line) for line in steps] == [number, number]
    heights = [line[:, 1].cumsum().tolist() for line in steps]
    assert heights[0] == sorted(heights[0]) and heights[1] == sorted(heights[1], reverse=True)  # down is larger
    assert "asg train bc" in picture and "loss" in picture and "validation" in picture


def test_a_picture_of_what_is_there() -> None:
    assert learning_curve("bc", []) is None and learning_curve("bc", [{"unit": 1, "train/loss": None}]) is None
    only_training = learning_curve("ppo", [{"unit": 1, "rollout/reward_per_episode": 2.0}])
    assert only_training is not None and len(curves(only_training)) == 1
    begun = [{"unit": 0, "validation/normalised": 0.5}, {"unit": 1, "rollout/reward_per_episode": 2.0}]
    assert len(curves(learning_curve("ppo", begun) or "")) == 2


def test_times_go_on_adding_and_stand_in_no_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = {"wall": 0.0, "processor": 0.0}
    monkeypatch.setattr(stopwatch.time, "monotonic", lambda: clock["wall"])
    monkeypatch.setattr(stopwatch, "processor_seconds", lambda: clock["processor"])

    def pass_on(wall: float, processor: float) -> None:
        clock["wall"] += wall
        clock["processor"] += processor

    for sitting in (1, 2):
        watch = stopwatch.Timing(tmp_path / "timing.json")
        watch.switch("collecting")
        pass_on(10.0, 18.0)
        watch.switch("updating")
        pass_on(5.0, 5.0)
        watch.save()  # the watch goes on
        pass_on(1.0, 1.0)
        watch.switch(None)
        pass_on(100.0, 100.0)
        watch.count("collecting", 200)
        watch.save()
        told = json.loads((tmp_path / "timing.json").read_text())
        assert told["sittings"] == sitting
        assert told["parts"]["collecting"] == {
            "wall_s": 10.0 * sitting, "processor_s": 18.0 * sitting, "steps": 200 * sitting, "steps_per_s": 20.0
        }  # fmt: skip
        assert told["parts"]["updating"] == {"wall_s": 6.0 * sitting, "processor_s": 6.0 * sitting}
        assert told["total"] == {"wall_s": 16.0 * sitting, "processor_s": 24.0 * sitting}
        assert {"processor", "cores"} <= set(told["hardware"])
    (tmp_path / "timing.json").write_text("{")  # damaged: begun again
    stopwatch.Timing(tmp_path / "timing.json").save()
    assert json.loads((tmp_path / "timing.json").read_text())["sittings"] == 1


def test_processor_time_counts_children_that_live() -> None:
    import subprocess

    before = processor_seconds()
    code = "import sys, time\nwhile time.process_time() < 0.3: pass\nprint('done', flush=True)\nsys.stdin.read()"
    child = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None and child.stdout.readline() == "done\n"
    if Path("/proc/self/stat").is_file():
        assert processor_seconds() - before >= 0.25
    child.communicate()
    assert processor_seconds() - before >= 0.25  # and when it has ended


class Writer:
    """Stands for TensorBoard's."""

    made: list[dict[str, Any]] = []

    def __init__(self, place: str, purge_step: int | None = None) -> None:
        self.scalars: list[tuple[str, int]] = []
        Writer.made.append({"purge": purge_step, "scalars": self.scalars})

    def add_scalar(self, name: str, value: float, step: int) -> None:
        self.scalars.append((name, step))

    def flush(self) -> None: ...

    def close(self) -> None: ...


def test_a_unit_that_is_done_again_shows_once_in_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Writer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    monkeypatch.setattr(Writer, "made", [])
    run = TrainingRun(tmp_path, CONFIG)
    finish(run, 0.9)
    monkeypatch.setattr(run, "_save", lambda *_: None)  # killed before the second unit's state is written
    finish(run, 0.8)
    again = TrainingRun(tmp_path, CONFIG)
    finish(again, 0.8)
    assert [one["purge"] for one in Writer.made] == [0, 2]  # steps from 2 on are forgotten
    assert {step for _, step in Writer.made[1]["scalars"]} == {2}


def test_a_unit_that_is_done_again_shows_once_to_tensorboard_s_own_reader(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard", reason="needs the extra `train`")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    for losses in ((0.9, 0.8), (0.7, 0.6)):
        run = TrainingRun(tmp_path, CONFIG)
        for number, loss in enumerate(losses):
            if number:
                run._save = lambda *_: None  # type: ignore[method-assign]
            finish(run, loss)
        run.close()
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("train/loss")] == [1, 2, 3]


def begun(place: Path) -> Path:
    """A run that was stopped after its first unit."""
    run = TrainingRun(place, CONFIG)
    model = torch.nn.ModuleDict({"network": CandidateNetwork(CONFIG.network())})
    optimizer = torch.optim.AdamW(model.parameters())
    sum(parameter.sum() for parameter in model.parameters()).backward()
    optimizer.step()
    run.finish_unit({"train/loss": 0.5}, model["network"], module_tensors(model) | optimizer_tensors(optimizer))
    run.close()
    return place


def restored(place: Path) -> int:
    """Open the run as `train_supervised` does."""
    run = TrainingRun(place, read_config(place))
    model = torch.nn.ModuleDict({"network": CandidateNetwork(run.config.network())})
    run.restore(model, torch.optim.AdamW(model.parameters()))
    run.close()
    return run.position


def test_a_run_that_was_stopped_is_gone_on_with(tmp_path: Path) -> None:
    assert restored(begun(tmp_path)) == 1


def state(place: Path, change: Any = lambda tensors: None, **notes: Any) -> None:
    """Write the run's state anew with changes."""
    with safe_open(place / STATE, "pt") as stored:
        tensors, meta = {name: stored.get_tensor(name) for name in stored.keys()}, stored.metadata()["training"]
    change(tensors)
    save_file(tensors, place / STATE, {"training": json.dumps(json.loads(meta) | notes)})


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda place: (place / STATE).write_bytes(b""), "state.safetensors' is damaged: .*not a whole safetensors"),
        (lambda place: (place / STATE).write_bytes(b"\xff" * 99), "state.safetensors' is damaged: .*header would have"),
        (lambda place: state(place, position=7), "it is of unit 7, of 3"),
        (lambda place: state(place, position="1"), "position: expected a whole number"),
        (lambda place: state(place, best=[]), "best: expected a number"),
        (lambda place: state(place, lambda t: t.pop("optimizer.0.exp_avg")), "lacks moments of the optimiser"),
        (lambda place: state(place, lambda t: t.update({"optimizer.x.step": torch.zeros(())})), "'optimizer.x.step'"),
        (lambda place: state(place, lambda t: t.update({"optimizer.0.exp_avg": torch.zeros(2)})), "of the shape"),
        (lambda place: state(place, lambda t: t.pop(next(n for n in t if "module" in n))), "weights of the configured"),
        (lambda place: state(place, lambda t: t["optimizer.0.step"].fill_(torch.nan)), "not finite"),
        (lambda place: state(place, lambda t: t["optimizer.0.step"].fill_(-1e30)), "'optimizer.0.step' below 0"),
        (lambda place: state(place, lambda t: t["optimizer.0.exp_avg_sq"].fill_(-1)), "exp_avg_sq' below 0"),
        (lambda place: (place / "log.jsonl").write_bytes(b"\xff\n"), "log.jsonl' is damaged: it is not UTF-8 text"),
        (lambda place: (place / "log.jsonl").write_text('{"unit": "a"}\n'), "unit: expected a whole number"),
        (lambda place: (place / "config.json").write_text("{}"), "config.json' is damaged: it lacks training"),
        (lambda place: (place / "config.json").unlink(), "no training run to go on with"),
    ],
)
def test_damage_names_the_file(change: Any, words: str, tmp_path: Path) -> None:
    change(begun(tmp_path))
    with pytest.raises(InputError, match=words) as error:
        restored(tmp_path)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    "change, words",
    [
        ({"method": []}, "unknown method"), ({"more": 1}, "not a description of a training run"),
        ({"world": {"features": 3}}, "features of a training world is a list"),
        ({"world": {"features": ["os:system"]}},
         "config.json' names the feature 'os:system', and to load it would run code"),
        ({"teacher": "os:system"}, "config.json' names the feature 'os:system', and to load it would run code"),
        ({"world": {"overrides": {"features": ["os:system"]}}}, "names the feature 'os:system'"),
        ({"world": {"overrides": {"mapper.name": "os:system"}}}, "names the mapper 'os:system'"),
        ({"world": {"overrides": 3}}, "overrides of a training world are names with values"),
        ({"world": {"preset": ["a"]}}, "preset of a training run is a text"),
        ({"world": {"noise": 3}}, "noise of a training run is true or false"),
        ({"planes": 10**9}, "planes of the network must be a whole number from 1 to 1024"),
    ],
)  # fmt: skip
def test_a_configuration_that_is_none_of_ours(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    content = json.loads((begun(tmp_path) / "config.json").read_text())
    content["training"]["world"] |= change.get("world", {})
    content["training"] |= {name: value for name, value in change.items() if name != "world"}
    (tmp_path / "config.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=words):
        read_config(tmp_path)
