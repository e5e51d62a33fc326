"""What the docs show is run as shown."""

from __future__ import annotations

import json
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.config import configure
from activestructure_gym.features import FEATURES
from activestructure_gym.geometry import PinholeCamera, look_along
from activestructure_gym.policies import POLICIES, make_env_and_policy
from activestructure_gym.policies.activestructure import LADDER
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
    from activestructure_gym.config import configure
    from activestructure_gym.envs.observation import CANDIDATE_COLUMNS, observation_table
    from activestructure_gym.planes import PLANE_FEATURES

    page = (ROOT / "docs" / "reference" / "observation.md").read_text()
    assert observation_table(configure("default"), max_planes=64) in page, (
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


def test_pictures_of_curves_are_those_of_their_numbers() -> None:
    images = ROOT / "docs" / "images"
    script = runpy.run_path(str(images / "benchmark_curves.py"))
    paper = runpy.run_path(str(images / "paper_curves.py"))
    native = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    pictures = {"benchmark_curves.svg": script["drawn"](), "policies.svg": script["panels"]()}
    for name, drawn in (
        pictures | {"paper_curves.svg": paper["drawn"](), "native_curves.svg": native["drawn"]()}
    ).items():
        assert drawn == (images / name).read_text(encoding="utf-8"), f"run docs/images/*_curves.py: {name}"


def test_a_native_table_by_hand() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    usual = dict.fromkeys(script["SHOWN"], "1") | {"scene": "x", "mapper": "splatam", "iterations": "15"}

    def run(policy: str, seed: str, observed: str, reached: str = "") -> dict[str, str]:
        return usual | {"policy": policy, "seed": seed, "observed": observed, "frames_to_80": reached}

    lines = [
        run("activestructure-d", "0", "90"),
        run("activestructure-d", "1", "92"),
        run("activestructure-d", "2", "1"),
    ]
    table = script["markdown"]([*lines, run("activestructure", "0", "93", "1500"), run("activestructure", "1", "93")])
    heads, _, first, second = ([cell.strip() for cell in line.split("|")] for line in table.splitlines())
    # The third seed, which one alone played, does not count.
    assert (first[1], second[1]) == ("`activestructure`", "`activestructure-d`")
    assert (first[heads.index("frames to 80 %")], second[heads.index("frames to 80 %")]) == ("1,500 (1 of 2)", "–")
    column = heads.index("observed minus `activestructure-d`")
    assert (first[column], second[column]) == ("+2.0 [1.0, 3.0]", "")


def test_chance_of_a_planner_by_hand() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    usual = dict.fromkeys(script["SHOWN"], "1") | {"scene": "x", "seed": "0", "mapper": "default", "iterations": "10"}
    usual |= {"ended_frame": "", "budget": "400"}
    lines = [
        usual | {"policy": "naruto", "ended_frame": "200", "curve": "40 80 80 80"},
        usual | {"policy": "random?views_of=naruto", "curve": "20 60 80 90"},
        usual | {"policy": "hole_area", "curve": "50 70 80 90"},
        usual | {"policy": "random", "curve": "50 60 60 60"},
        usual | {"policy": "gavis", "curve": "1 2 3 4"},  # has own settings, and chance was not played with them
    ]
    table = script["markdown"](lines)
    heads, _, *body = ([cell.strip() for cell in line.split("|")] for line in table.splitlines())
    cells = {
        row[1]: tuple(row[heads.index(f"{name} minus chance")] for name in ("observed", "exploration")) for row in body
    }
    # naruto ended at frame 200: 80 and 60 there. The means up to there are (20 + 60) / 2 and (10 + 40) / 2.
    # hole_area: 90 and 60 at frame 400, and means of 61.25 and 50.
    assert cells["`naruto`"] == ("+20.0", "+15.0")
    assert cells["`hole_area`"] == ("+30.0", "+11.2")
    assert cells["`random`"] == cells["`gavis`"] == ("", "")
    assert len(cells) == 4, "chance with the settings of a planner has no row"


def test_every_threshold_that_is_a_guess_is_there() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "thresholds.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    for guesses in script["GUESSES"].values():
        for words, (module, constant) in guesses.items():
            assert f"{words} | {getattr(module, constant):.3g} |" in told, words


def test_the_native_table_is_that_of_its_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    assert script["native_settings"]() in told, "paste what native_table.py prints"
    for place in (script["PLACE"], script["PLACE"].with_name("paper.csv")):
        assert all(table in told for table in script["tables"](place).values()), "paste what native_table.py prints"
        for row in script["rows"](place):  # or what is said of it would be of another schedule
            policy = row["policy"].removeprefix(script["FLOOR"]).partition("?")[0]
            settings = POLICIES.get(policy).native_settings
            mapper = configure("full", settings.overrides()).mapper
            assert (row["mapper"], row["iterations"]) == (mapper.name, str(mapper.iterations)), row["policy"]


def test_completion_by_the_papers_protocols_is_that_of_the_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    runs = {(row["scene"], row["policy"]): row for row in script["rows"]()}
    asked = {"activegamer": "activegamer", "activesplat": "activesplat", "anm_s": "activesplat", "naruto": "naruto"}
    for planner, protocol in asked.items():
        cells = [
            f"{float(runs[scene, name][f'{protocol}/completion_ratio']):.1f}"
            for scene in ("room?seed=12", "houses_20_house_5") for name in (planner, script["FLOOR"] + planner)
        ]  # fmt: skip
        assert f"| `{planner}` | `{protocol}` | {' | '.join(cells)} |" in told, planner


@pytest.mark.parametrize("runs", ["benchmark.csv", "headline.csv", "procthor.csv"])
def test_the_tables_of_results_are_those_of_their_runs(runs: str) -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    table = script["read"](script["PLACE"].with_name(runs))
    pairs = {"headline.csv": script["HEADLINE"], "procthor.csv": [("activestructure", "unknown_volume")]}.get(runs, [])
    wanted = [(f"`{ours}` minus `{theirs}`", ours, theirs) for ours, theirs in pairs]
    expected = [script["pairs"](table, wanted)] if wanted else []
    expected += [script["markdown"](table)] if runs != "headline.csv" else []
    page = (ROOT / "docs" / "notebook" / "benchmark.md").read_text()
    assert all(one in page for one in expected), (
        f"benchmark.md is out of date: paste what benchmark_table.py prints of {runs}"
    )


def test_the_ablation_has_the_ladders_side_by_side() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    told = script["ladders"](script["PLACE"].parent)
    assert told in (ROOT / "docs" / "notebook" / "ablation.md").read_text(), "paste what --ladders prints"


def test_the_ablation_has_the_runs_of_the_phases() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    told = (ROOT / "docs" / "notebook" / "ablation.md").read_text()
    assert all(script["phases"](file) in told for file in script["PHASES"]), "paste what --phases prints"


def test_readme_has_the_benchmark_s_numbers() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    told = script["readme"](script["read"](script["PLACE"].with_name("headline.csv")))
    assert told in (ROOT / "README.md").read_text(), "README.md is out of date: paste what --readme prints"


@pytest.mark.parametrize("film", ["replay.webp", "kitchen.webp"])
def test_the_films_of_the_docs_are_short_and_small(film: str) -> None:
    path = ROOT / "docs" / "images" / film
    assert path.stat().st_size < 3e6
    with Image.open(path) as shown:
        assert shown.size == (1200, 686)  # two maps side by side, as `asg replay RUN RUN --video` writes them
        durations = []
        for number in range(shown.n_frames):  # type: ignore[attr-defined]
            shown.seek(number)
            assert np.asarray(shown.convert("L")).std() > 10
            durations.append(shown.info["duration"])  # known after the image has been read
    assert sum(durations) == pytest.approx(6000, abs=100)


@pytest.mark.parametrize("picture", ["replay.webp", "views.jpg"])
def test_the_pictures_of_readme_are_of_the_median_cell_and_have_its_numbers(picture: str) -> None:
    images = ROOT / "docs" / "images"
    script = runpy.run_path(str(images / "cell.py"))
    told = json.loads((images / picture).with_suffix(".json").read_text(encoding="utf-8"))
    table = script["stored"]()
    cell = script["median_cell"](table)
    assert (told["scene"], told["seed"]) == cell
    assert {"hole_area", "activestructure"} <= told["runs"].keys()
    for policy, numbers in told["runs"].items():
        assert numbers == {name: table[policy][cell][name] for name in script["NUMBERS"]}, policy


def test_a_ladder_by_hand() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))

    def runs(*values: float, depth: float = 1.0) -> dict[tuple[str, int], dict[str, float]]:
        usual = dict.fromkeys(script["OF_PAIRS"], 1.0)
        return {("x", seed): usual | {"psnr": value, "depth_l1_cm": depth} for seed, value in enumerate(values)}

    table = {
        "pixel_only": runs(20, 22),
        "activestructure-b": runs(21, 23, 99, depth=0.5),  # the third seed, which one alone played, does not count
        "activestructure-c": runs(21, 21),
        "activestructure-d": runs(21, 21),
        LADDER[-1]: runs(20, 21),
    }
    rungs = script["ladder"](table)
    steps = [(ours, theirs) for _, ours, theirs in rungs]
    assert steps[:4] == list(zip(list(table)[1:], table)) and steps[4] == (list(table)[-1], "pixel_only")
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in script["pairs"](table, rungs).splitlines()]
    columns = [lines[0].index(name) for name in ("pairs", "PSNR (dB)", "better in PSNR", "depth error, ratio")]
    assert [[line[column] for column in columns] for line in lines[2:4]] == [
        ["2", "+1.00 [1.00, 1.00]", "2", "0.50 [0.50, 0.50]"],
        ["2", "-1.00 [-2.00, 0.00]", "0", "2.00 [2.00, 2.00]"],
    ]
    del table["activestructure-c"]
    assert script["ladder"](table) == []


def test_readme_and_results_are_short() -> None:
    def words(path: Path) -> int:
        return sum(any(letter.isalnum() for letter in word) for word in path.read_text(encoding="utf-8").split())

    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 130 and words(ROOT / "README.md") <= 1_150
    results = {path.name: words(path) for path in (ROOT / "docs" / "notebook").glob("*.md")}
    assert max(results.values()) <= 2_500 and sum(results.values()) <= 12_000, results


def test_readme_s_conclusions_are_those_of_the_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").replace("−", "-").split())
    assert f"It has {len([*POLICIES])} planners" in text
    longer = (ROOT / "docs" / "notebook" / "performance.md").read_text(encoding="utf-8")
    percents = re.findall(r"(?:C.R. of|three rooms) ([\d.]+) %", text)
    assert len(percents) == 2 and all(f"| {percent} / " in longer for percent in percents)

    table = script["read"](script["PLACE"])
    # Planners of information alone: those that have a variant with coverage, and activeinr.
    seen = [
        script["_mean"]({cell: run["observed"] for cell, run in table[name].items()})
        for name in ("activeinr", *(name for name in table if f"{name}_cov" in table))
    ]
    assert len(seen) > 8 and f"only information in the map observe {min(seen):.0f} to {max(seen):.0f} %" in text
    houses = script["read"](script["PLACE"].with_name("procthor.csv"))
    assert f"In {len(houses['hole_area'])} published [ProcTHOR houses]" in text

    def difference(file: str, ours: str, theirs: str, key: str) -> str:
        table = script["read"](script["PLACE"].with_name(file))
        return script["_difference"](table, ours, theirs, key, script["OF_PAIRS"][key][1])

    planes = ("headline.csv", "activestructure", "unknown_volume")
    assert f"by {difference(*planes, 'observed_area')} points" in text
    assert f"PSNR changes by {difference(*planes, 'psnr')} dB" in text
    lead = ("headline.csv", "unknown_volume", "hole_area")
    assert f"`unknown_volume` minus `hole_area` is {difference(*lead, 'observed_area')} points of exploration" in text
    assert f"PSNR differs by {difference(*lead, 'psnr')} dB" in text
    rung, full = "activestructure-d?discovery=hole_area", "activestructure?discovery=hole_area&revisits=true"
    assert f"without them:** {difference('ladder_2000.csv', full, rung, 'psnr')} dB" in text
    rung, full = "activestructure-d", "activestructure?discovery=pixel&revisits=true"
    assert f"and {difference('paper.csv', full, rung, 'psnr').removeprefix('+')} dB in one room" in text
    assert f"has {difference('procthor.csv', 'activestructure', 'hole_area', 'psnr')} dB" in text
    houses = difference("procthor.csv", "activestructure", "unknown_volume", "observed_area")
    assert f"in the houses by {houses}." in text
    calm = difference("phases_rooms.csv", "activestructure", "activestructure?revisits=true", "psnr")
    assert f"The revisits in phase III cost {calm.removeprefix('+')} dB" in text
    for base, file in (("hole_area", "ladder_2000.csv"), ("pixel_only", "ladder_pixels_2000.csv")):
        first = "activestructure-b" + ("?discovery=hole_area" if base == "hole_area" else "")
        assert difference(file, first, base, "psnr").startswith(("-0.7", "-0.6"))  # "visible planes cost 0.7 dB"
