"""What the docs show is run as shown."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from activestructure_gym.config import configure
from activestructure_gym.features import FEATURES
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.policies import POLICIES, make_env_and_policy
from activestructure_gym.sources import SOURCES
from tests.bare_jobs import bare_jobs

ROOT = Path(__file__).resolve().parents[1]


def blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The files of docs/howto/own_feature.md and own_planner.md and those of two examples, importable."""
    for example, module in (("02_own_policy", "my_policy"), ("04_own_scene", "my_scene")):
        (tmp_path / f"{module}.py").write_text((ROOT / "examples" / f"{example}.py").read_text())
    for page, block in [
        (name, one) for name in ("own_feature", "own_planner") for one in blocks(f"docs/howto/{name}.md")
    ]:
        name = re.match(r"# (\w+\.py)\n", block)
        assert name, f"a block of {page} does not begin with its file name:\n{block}"
        (tmp_path / name[1]).write_text(block)
        filled = [line for line in block.splitlines() if line.strip()]
        assert len(filled) <= (20 if name[1] != "my_planner.py" else 55)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in ("thin_cover", "entropy"):
        FEATURES._entries.pop(name, None)
    for name in ("area_first", "most_entropy"):
        POLICIES._entries.pop(name, None)
    SOURCES._entries.pop("rings", None)
    for module in ("my_policy", "my_feature", "my_planner", "my_scene"):
        sys.modules.pop(module, None)


def test_third_party_policy_feature_and_scene_work_together(plugins: Path) -> None:
    from activestructure_gym.envs import ReconstructionEnv
    from activestructure_gym.policies import POLICIES

    policy = POLICIES.get("my_policy:AreaFirst")()
    env = ReconstructionEnv(
        scene="my_scene:cube_room?side=5",
        preset="fast",
        frame_budget=15,
        features=("hole_area", "my_feature:thin_cover"),
    )
    policy.bind(env.config.features)
    policy.reset(0)
    observation, info = env.reset(seed=0)
    np.testing.assert_allclose(np.ptp(env.reconstruction.scene.bounds, axis=0), (5.0, 5.0, 2.6), atol=1e-5)
    while True:
        observation, _, terminated, truncated, info = env.step(policy.act(observation))
        if terminated or truncated:
            break
    assert info["metres"] > 0 or info["keyframes"] > 1


def test_an_own_candidate_source_is_one_short_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, use = blocks("docs/howto/own_source.md")
    assert sum(bool(line.strip()) for line in source.splitlines()) < 20
    (tmp_path / "my_source.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    shown: dict[str, Any] = {}
    try:
        exec(compile(use, "own_source.md", "exec"), shown)
        env = shown["env"]
        env.reset(seed=0)
        episode = env.reconstruction
        ahead = np.nonzero(episode.candidates.source == 1)[0][1]  # the first one is where it stands
        towards = episode.candidates.world_from_camera[ahead, :3, 3] - episode.pose[:3, 3]
        steps = towards @ episode.pose[:3, 2] / 0.3
        np.testing.assert_allclose(towards, round(steps) * 0.3 * episode.pose[:3, 2], atol=1e-9)
        *_, info = env.step(int(ahead))
        assert info["reached"] and info["metres"] == pytest.approx(0.3 * steps)
    finally:
        SOURCES._entries.pop("ahead", None)
        sys.modules.pop("my_source", None)


def test_a_planner_with_feature_source_and_schedule_is_one_file(plugins: Path) -> None:
    small: dict[str, Any] = {"config": {"sensor": {"width": 48, "height": 27}, "views.max_candidates": 128}}
    choices = {}
    for spec in ("my_planner:MostEntropy", "my_planner:MostEntropy?gain=unseen&patience=3"):
        for setup in ("shared", "native"):
            env, policy = make_env_and_policy(spec, scene="box", preset="fast", frame_budget=40, setup=setup, **small)
            policy.reset(0)
            observation, info = env.reset(seed=0)
            assert info["features"] == ("entropy_bits", "entropy_unseen")
            assert (env.unwrapped.config.keyframe_every == 8) == (setup == "native")
            chosen, ended = [], False
            while not ended:
                chosen.append(policy.act(observation))
                assert observation["action_mask"][chosen[-1]]
                observation, _, terminated, truncated, info = env.step(chosen[-1])
                ended = terminated or truncated
            choices[spec, setup] = chosen
            assert info["keyframes"] > 1
    assert len(set(map(tuple, choices.values()))) > 2


def test_the_one_file_planner_passes_the_checks_and_is_compared_natively(plugins: Path, tmp_path: Path) -> None:
    from activestructure_gym import compare
    from activestructure_gym.checks import check_feature, check_source
    from activestructure_gym.evaluation import Conditions, StandardProtocol

    assert check_feature("my_planner:entropy").decisions and check_source("my_planner:Rings").decisions
    conditions = Conditions(
        preset="fast",
        frame_budget=20,
        setup="native",
        overrides={"sensor.width": 48, "sensor.height": 27},
        protocol=StandardProtocol(views=1, surface_samples=2000, points_source="means"),
    )
    with bare_jobs():
        result = compare(["box"], ["my_planner:MostEntropy"], tmp_path / "runs", conditions=conditions, engine="inline")
    assert not result.failed and "rings" in str(result.runs[0].directory.joinpath("config.json").read_text())


def test_entropy_of_the_one_file_planner_is_that_of_its_formula(plugins: Path) -> None:
    """In unknown space of p = 1/2, a ray of n voxels meets sum of 2^-i = 2 bits; in free space none."""
    from activestructure_gym.volume import VoxelVolume

    feature = FEATURES.get("my_planner:entropy")
    volume, camera = VoxelVolume(np.array([[0.0, 0, 0], [4.0, 3, 2.5]])), PinholeCamera.from_size(32, 18)
    pose = look_along(np.array([2.0, 1.5, 1.2]), np.array([1.0, 0.2, 0.0]))[None]
    context = SimpleNamespace(volume=volume, camera=camera, world_from_camera=pose, max_range=2.0)
    bits, unseen = feature(context)[0]  # type: ignore[arg-type]
    assert bits == pytest.approx(2.0, abs=0.01) and 15 < unseen < 35
    volume.mark_free_sphere(np.array([2.0, 1.5, 1.2]), 5.0)
    assert feature(context)[0] == pytest.approx([0.0, 0.0], abs=1e-3)  # type: ignore[arg-type]


def readme_with(policy: str, scene: str) -> str:
    """README's lines for another policy and scene, and nothing else changed."""
    shown = blocks("README.md")[0]
    assert len([line for line in shown.splitlines() if line.strip()]) <= 12
    text, changes = re.subn(r'\("hole_area", scene="room", ', f'("{policy}", scene={scene}, ', shown)
    assert changes == 1
    return text


@pytest.mark.parametrize("page", ["README.md", "docs/package_index.md"])
def test_the_first_example_of_a_page_runs(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(blocks(page)[0], page, "exec"), {})
    assert re.search(r"Gaussians after 100 frames and \d+\.\d m\n$", capsys.readouterr().out)


@pytest.mark.parametrize("policy", sorted(POLICIES))
def test_every_policy_plays_in_the_readme_s_lines(policy: str, capsys: pytest.CaptureFixture[str]) -> None:
    small = '"box", frame_budget=15, config={"sensor": {"width": 48, "height": 27}, "views.max_candidates": 12}'
    exec(compile(readme_with(policy, small), "README.md", "exec"), {})
    assert "Gaussians after 15 frames" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("policy", sorted(POLICIES))
def test_every_policy_plays_the_readme_s_episode(policy: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(readme_with(policy, '"room"'), "README.md", "exec"), {})
    assert "Gaussians after 100 frames" in capsys.readouterr().out


def test_the_page_of_the_observation_is_up_to_date() -> None:
    from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, observation_table
    from activestructure_gym.planes import PLANE_FEATURES

    page = (ROOT / "docs" / "reference" / "observation.md").read_text()
    assert observation_table(configure("default"), max_planes=256) in page, (
        "docs/reference/observation.md is out of date: paste the output of observation_table(configure('default'), 64)"
    )
    for name in (*CANDIDATE_COLUMNS, *PLANE_FEATURES):
        assert f"`{name}`" in page


def test_the_rasteriser_s_example_runs() -> None:
    scope: dict[str, Any] = {}
    (block,) = blocks("docs/notebook/rasteriser.md")
    exec(compile(block, "docs/notebook/rasteriser.md", "exec"), scope)
    assert scope["picture"].color.shape == (120, 160, 3)
    assert float(scope["means"].grad.abs().sum()) > 0


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_every_policy_says_in_its_folder_what_lists_show(name: str) -> None:
    kind = POLICIES.get(name)
    assert kind.__doc__ and kind.criterion and kind.source and kind.travel_term
