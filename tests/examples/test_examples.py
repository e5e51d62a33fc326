"""The examples run, in small. That of RLlib needs the extra `rllib`."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.policies import POLICIES
from activestructure_gym.scenes import SCENES
from tests.bare_jobs import bare_jobs
from tests.conftest import ROOT

EXAMPLES = ROOT / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def in_small(text: str) -> str:
    """The same program with a box for a room, an update of 8 steps, and only one of them."""
    text, boxes = re.subn(
        r'ActiveStructure/Room-v0", ', 'ActiveStructure/Room-v0", scene="box", frame_budget=20, ', text
    )
    text, sizes = re.subn(r"n_steps=64, batch_size=64", "n_steps=8, batch_size=8", text)
    text, steps = re.subn(r"learn\(4096\)", "learn(8)", text)
    assert (boxes, sizes, steps) == (1, 1, 1)
    return text


def program(text: str) -> list[str]:
    """Its lines without docstring and empty ones."""
    return [line for line in re.sub(r'^""".*?"""\n', "", text, flags=re.DOTALL).splitlines() if line.strip()]


def test_twelve_lines_of_stable_baselines3(capsys: pytest.CaptureFixture[str]) -> None:
    text = (EXAMPLES / "03_train.py").read_text()
    lines = program(text)
    assert len(lines) - 1 == 12 and lines[-1].startswith("print(")
    exec(compile(in_small(text), "03_train.py", "exec"), {"__name__": "example"})
    assert "20 frames" in capsys.readouterr().out


def test_every_numbered_example_is_shown_by_one_page_and_begins_where_it_says() -> None:
    pages = "\n".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*/*.md"))
    shown = dict(re.findall(r"{literalinclude} \.\./\.\./examples/(\w+)\.py\n:(?:start-at|pyobject): (.*)", pages))
    numbered = sorted(EXAMPLES.glob("[0-9]*.py"))
    assert [path.stem[:2] for path in numbered] == [f"0{number}" for number in range(6)]
    assert sorted(shown) == [path.stem for path in numbered] and pages.count("{literalinclude}") == 6
    for path in numbered:
        assert path.read_text(encoding="utf-8").count(shown[path.stem]) >= 1


@pytest.mark.parametrize(
    ("name", "small", "said"),
    [
        ("01_compare", {}, r"pixel_only C\.R\. [\d.]+ % PSNR [\d.]+ dB\n$"),
        ("02_own_policy", {'scene="room"': 'scene="box", frame_budget=15'}, r"\d+ Gaussians after 15 frames"),
        ("04_own_scene", {}, r"[1-9]\d* start poses"),
        ("05_own_world", {"scene=room": "scene=box", "60": "15"}, r"\d+ Gaussians after"),
    ],
)
def test_a_numbered_example_runs(
    name: str, small: dict[str, str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for registry in (POLICIES, SCENES):
        assert list(registry)  # it finds its entries now, or those found later would be lost
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    text = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    for usual, short in small.items():
        assert usual in text
        text = text.replace(usual, short)
    module = ModuleType("__main__")
    with bare_jobs():
        exec(compile(text, name, "exec"), module.__dict__)
    assert re.search(said, capsys.readouterr().out)


def shown_for(library: str) -> str:
    """The block of the page on training that imports a library, with a box for a room."""
    text = (ROOT / "docs" / "start" / "training.md").read_text(encoding="utf-8")
    (block,) = (one for one in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if library in one)
    return re.sub(r'preset="fast"(, frame_budget=30)?', 'preset="fast", scene="box", frame_budget=10', block)


def test_minari_writes_and_reads_a_data_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari", reason='pip install "minari[create]" h5py')
    pytest.importorskip("jax", reason='pip install "minari[create]"')
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    with pytest.warns(UserWarning):
        exec(compile(shown_for("minari"), "training.md", "exec"), {"__name__": "example"})
    episodes = list(minari.load_dataset("activestructure/room-v0").iterate_episodes())
    assert len(episodes) == 2 and all(len(one.observations["rgb"]) == len(one.actions) + 1 for one in episodes)


def test_torchrl_plays_with_the_mask() -> None:
    pytest.importorskip("torchrl", reason="pip install torchrl")
    names: dict[str, Any] = {"__name__": "example"}
    exec(compile(shown_for("torchrl"), "training.md", "exec"), names)
    rollout = names["rollout"]
    taken = rollout["action_mask"].gather(-1, rollout["action"][..., None])
    assert taken.all()


def test_tianshou_collects_with_the_mask(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tianshou", reason="pip install tianshou")
    names: dict[str, Any] = {"__name__": "example"}
    exec(compile(shown_for("tianshou"), "training.md", "exec"), names)
    taken, _ = names["collector"].buffer.sample(0)
    assert capsys.readouterr().out.endswith("8 steps\n") and len(taken) == 8
    assert taken.obs.mask[np.arange(8), taken.act].all()


def test_a_flat_vector_environment_resets_in_the_same_step(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {"__name__": "example"}
    exec(compile(shown_for("AutoresetMode"), "training.md", "exec"), names)
    assert names["observation"].shape == names["envs"].observation_space.shape and len(names["observation"]) == 2
    assert not names["info"]["invalid_action"].any() and "[" in capsys.readouterr().out  # an episode has ended


def test_any_policy_is_played(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example = load("00_play")
    for policy in ("hole_area", "activestructure"):
        args = example.Args(policy=policy, scene="box", frames=20, picture=tmp_path / "last.png")
        rows = example.main(args)
        assert capsys.readouterr().out.count("reward") == len(rows) >= 2
        assert (tmp_path / "last.png").stat().st_size > 1000


@pytest.mark.slow
def test_ppo_in_a_single_file(capsys: pytest.CaptureFixture[str]) -> None:
    example = load("ppo_single_file")
    args = example.Args(frames=12, num_envs=2, num_steps=6, total_steps=24, minibatch=8, update_epochs=1)
    room = "activestructure_gym:ActiveStructure/Room-v0"
    example.gym.register("BoxForThisTest-v0", lambda **o: example.gym.make(room, scene="box", **o).unwrapped)
    try:
        args.env_id = "BoxForThisTest-v0"
        history = example.main(args)
    finally:
        del example.gym.registry["BoxForThisTest-v0"]
    assert len(history) == 2 and np.isfinite(history).all() and history[0] > 0
    assert "update 2: reward per step" in capsys.readouterr().out


def test_the_single_file_s_agent_never_takes_a_masked_row(rng: np.random.Generator) -> None:
    import torch

    from tests.policies.learned.toys import random_observation

    example = load("ppo_single_file")
    agent = example.Agent(2, 27)
    for valid in (1, 5, 16):
        observation = random_observation(rng, 16, valid, 7)
        distribution, value = agent(example.tensors({key: observation[key][None] for key in example.KEYS}))
        drawn = distribution.sample(torch.Size([200]))[:, 0].numpy()
        assert observation["action_mask"][drawn].all() and value.shape == (1,)


@pytest.mark.slow
def test_rllib_runs_two_iterations(tmp_path: Path) -> None:
    pytest.importorskip("ray.rllib", reason="needs the extra `rllib`", exc_type=ImportError)
    example = load("rllib_ppo")
    returns = example.main(example.Args(frames=12, iterations=2, env_runners=0, steps=16))
    assert len(returns) == 2 and np.isfinite(returns).all()


@pytest.mark.slow
def test_the_notebook_plays_and_shows_a_replay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its cells run without IPython; of the lines that IPython runs itself, those of pip are left out."""
    from activestructure_gym.evaluation.cli import main

    shown: list[str] = []
    display = SimpleNamespace(HTML=shown.append)
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "activestructure-gym").mkdir()
    (tmp_path / "activestructure-gym" / "setup.cfg").touch()
    cells = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells)
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    text = re.sub(r"^%pip .*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^!asg (.*)$", lambda line: f"asg({line[1].split()!r})", text, flags=re.MULTILINE)
    text = text.replace('scene="room"', 'scene="box", frame_budget=15')
    assert text.count("'--scenes', 'room'") == 1
    text = text.replace("'--scenes', 'room'", "'--scenes', 'box', '--frames', '15'")
    with bare_jobs():
        exec(compile(text, "notebook.ipynb", "exec"), {"__name__": "notebook", "asg": main})
    assert "Gaussians after 15 frames" in capsys.readouterr().out
    assert len(shown) == 1 and "srcdoc=" in shown[0] and len(shown[0]) > 100_000
