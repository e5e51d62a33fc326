"""The checks of plug-ins, on good ones and on one fault each; and the plug-ins that ``asg new`` writes."""

from __future__ import annotations

import importlib
import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from activestructure_gym.checks import check_feature, check_policy, check_source, check_world
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli import main
from activestructure_gym.features import FEATURES
from activestructure_gym.policies import NativeSettings, Policy
from activestructure_gym.policies.base import best_valid
from activestructure_gym.sources import SOURCES, Proposals, Source
from activestructure_gym.worlds.simulated_world import SimulatedRobot


def test_good_ones_pass() -> None:
    assert check_policy("hole_area", "box", frames=40).decisions > 1
    assert 0.0 < check_feature("hole_area", "box").seconds_per_256 < 60.0
    assert check_source("around", "box").decisions > 1
    check_world("simulated?scene=box&width=48&height=36")
    check_world(SimulatedRobot("box", width=48, height=36))


def policy_that(act: Callable[[Any, Any], Any]) -> type[Policy]:
    return type("Faulty", (Policy,), {"act": act, "__doc__": "Have one fault."})


class Counting:
    count = 0


def _writes(self: Policy, observation: dict[str, np.ndarray]) -> int:
    observation["budget"][0] = 0.5
    return 0


def _drifts(self: Policy, observation: dict[str, np.ndarray]) -> int:
    Counting.count += 1
    return best_valid(np.roll(np.arange(len(observation["action_mask"]), dtype=float), Counting.count), observation)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (_writes, r"act\(\) changed observation\['budget'\]"),
        (lambda self, observation: 0.0, "whole number"),
        (lambda self, observation: len(observation["action_mask"]) - 1, "holds no candidate"),
        (_drifts, "two episodes with the same seed"),
    ],
)
def test_faulty_policies(act: Callable[[Any, Any], Any], message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_policy(policy_that(act), "box", frames=40)


def test_a_policy_that_keeps_state_or_has_wrong_native_settings_is_refused() -> None:
    class Remembers(Policy):
        count = 0

        def act(self, observation: Any) -> int:
            self.count += 1
            return best_valid(np.roll(np.arange(len(observation["action_mask"]), dtype=float), self.count), observation)

    with pytest.raises(AssertionError, match="keep no state over reset"):
        check_policy(Remembers, "box", frames=40)

    class Misspells(Policy):
        native_settings = NativeSettings(changes={"sensor.widht": 64})

        def act(self, observation: Any) -> int:
            return best_valid(observation["candidates"][:, 0], observation)

    with pytest.raises(InputError, match="widht"):
        check_policy(Misspells, "box", frames=40)


def _clips(context: Any) -> np.ndarray:
    gaussians = context.mapper.map
    np.minimum(gaussians.parameters[10, : gaussians.count], -2.0, out=gaussians.parameters[10, : gaussians.count])
    return np.zeros(len(context.world_from_camera))


@pytest.mark.parametrize(
    ("compute", "message"),
    [
        (_clips, "changed the map"),  # the second time it changes nothing
        (lambda context: np.full(len(context.world_from_camera), 2.0), "outside its declared bounds"),
        (lambda context: np.random.default_rng().random(len(context.world_from_camera)), "other values"),
        (
            lambda context: (context.volume.tsdf.__iadd__(0.5), np.zeros(len(context.world_from_camera)))[1],
            "changed the map, the volume, the planes or the camera's path",
        ),
    ],
)
def test_faulty_features(compute: Any, message: str) -> None:
    FEATURES.register("faulty", unit="share", low=0.0, high=1.0)(compute)
    try:
        with pytest.raises(AssertionError, match=message):
            check_feature("faulty", "box")
        FEATURES.register("faulty")(lambda context: np.full(len(context.world_from_camera), np.nan))
        with pytest.raises(InputError, match="finite"):
            check_feature("faulty", "box")
    finally:
        del FEATURES._entries["faulty"]


def test_faulty_sources() -> None:
    class Random(Source):
        def propose(self, context: Any) -> Proposals:
            turns = SOURCES.get("turns")().propose(context)
            return Proposals(np.random.default_rng().permutation(turns.world_from_camera))

    class Far(Source):
        def propose(self, context: Any) -> Proposals:
            pose = context.agent.pose.copy()
            pose[:3, 3] += 100.0
            return Proposals(pose[None])

    class Writing(Source):
        def propose(self, context: Any) -> Proposals:
            context.volume.tsdf[:] += 0.5
            return SOURCES.get("turns")().propose(context)

    faults = (Random, "other views in an equal episode"), (Far, "proposed no view"), (Writing, "changed the map")
    for kind, message in faults:
        SOURCES.register("faulty")(kind)
        try:
            with pytest.raises(AssertionError, match=message):
                check_source("faulty", "box")
        finally:
            del SOURCES._entries["faulty"]


class Noisy(SimulatedRobot):
    def capture(self, world_from_camera: np.ndarray) -> Any:
        frame = super().capture(world_from_camera)
        frame.rgb[:] = np.random.default_rng().integers(0, 256, frame.rgb.shape)
        return frame


class Holed(SimulatedRobot):
    def capture(self, world_from_camera: np.ndarray) -> Any:
        frame = super().capture(world_from_camera)
        frame.depth[:2] = np.nan
        return frame


class Unit(SimulatedRobot):
    def capture(self, world_from_camera: np.ndarray) -> Any:
        frame = super().capture(world_from_camera)
        return replace(frame, rgb=frame.rgb / 255.0)


@pytest.mark.parametrize("kind", ["Holed", "Unit"])  # pixels without depth; colours in 0..1
def test_a_world_can_have_what_the_environment_takes(kind: str) -> None:
    check_world(f"{__name__}:{kind}?scene=box&width=48&height=36")


def test_faulty_worlds() -> None:
    class Blind(SimulatedRobot):
        empty = 0.0

        def capture(self, world_from_camera: np.ndarray) -> Any:
            frame = super().capture(world_from_camera)
            frame.depth[:] = self.empty
            return frame

    class Void(Blind):
        empty = np.inf

    class Elsewhere(SimulatedRobot):
        def capture(self, world_from_camera: np.ndarray) -> Any:
            frame = super().capture(world_from_camera)
            frame.world_from_camera[0, 3] += 0.6
            return frame

    class Millimetres(SimulatedRobot):
        kind: Any = np.float32

        def capture(self, world_from_camera: np.ndarray) -> Any:
            frame = super().capture(world_from_camera)
            return replace(frame, depth=(1000.0 * np.nan_to_num(frame.depth, posinf=0.0)).astype(self.kind))

    class Whole(Millimetres):
        kind = np.uint16

    with pytest.raises(AssertionError, match="if they are in millimetres"):
        check_world(Millimetres("box", width=48, height=36))
    with pytest.raises(InputError, match="divide millimetres"):
        check_world(Whole("box", width=48, height=36))
    with pytest.raises(AssertionError, match="0.60 m away"):
        check_world(Elsewhere("box", width=48, height=36))
    with pytest.raises(AssertionError, match="two fresh worlds"):
        check_world(f"{__name__}:Noisy?scene=box&width=48&height=36")
    for kind in (Blind, Void):
        with pytest.raises(AssertionError, match="no depth"):
            check_world(kind("box", width=48, height=36))
    with pytest.raises(AssertionError, match="members"):
        check_world(object())  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["policy", "feature", "source", "world"])
def test_asg_new_writes_a_plugin_whose_test_passes(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"my_{kind}"
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["new", kind, name]) == 0
    said = capsys.readouterr().out
    assert f"python -m pytest test_{name}.py" in said
    (command,) = (line for line in said.splitlines() if line.strip().startswith("asg "))
    values = [word.partition("=")[2] for word in shlex.split(command) if word.startswith("views.stages=")]
    assert [json.loads(value) for value in values] == [[["my_source:MySource"]]] * (kind == "source")
    try:
        module = importlib.import_module(f"test_{name}")
        tests = [value for key, value in vars(module).items() if key.startswith("test_")]
        assert tests
        for test in tests:
            test()
    finally:
        for loaded in (name, f"test_{name}"):
            sys.modules.pop(loaded, None)
    assert main(["new", kind, name]) == 2  # nothing is overwritten
    assert "exists already" in capsys.readouterr().err


def test_asg_new_refuses_names_that_are_no_modules(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("Mine", "my-policy", "1st", "class", "../mine"):
        assert main(["new", "policy", name]) == 2
        assert "lower-case letters" in capsys.readouterr().err
    assert main(["new", "robot", "mine"]) == 2
    capsys.readouterr()
    assert main(["new", "policy", "numpy"]) == 2  # its folder could no longer import NumPy
    assert "'numpy' would hide a module of the same name" in capsys.readouterr().err
