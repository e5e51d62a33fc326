"""The numbers, tables and pictures of README and of the results pages are those of their CSVs."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from activestructure_gym.config import configure
from activestructure_gym.errors import InputError
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.activestructure import LADDER

ROOT = Path(__file__).resolve().parents[1]


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
        return usual | {"policy": policy, "seed": seed, "observed": observed, "ended_frame": reached}

    lines = [
        run("activestructure-d", "0", "90"),
        run("activestructure-d", "1", "92"),
        run("activestructure-d", "2", "1"),
    ]
    table = script["markdown"]([*lines, run("activestructure", "0", "93", "1500"), run("activestructure", "1", "93")])
    heads, _, first, second = ([cell.strip() for cell in line.split("|")] for line in table.splitlines())
    # The third seed, which one alone played, does not count.
    assert (first[1], second[1]) == ("`activestructure`", "`activestructure-d`")
    assert (first[heads.index("ended at frame")], second[heads.index("ended at frame")]) == ("1,500 (1 of 2)", "–")
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
    cells = {row[1]: row[heads.index("exploration minus chance")] for row in body}
    # naruto ended at frame 200: the means up to there are (20 + 60) / 2 and (10 + 40) / 2. hole_area: 61.25 and 50.
    assert cells["`naruto`"] == "+15.0" and cells["`hole_area`"] == "+11.2"
    assert cells["`random`"] == cells["`gavis`"] == ""
    assert len(cells) == 4, "chance with the settings of a planner has no row"


def test_a_table_by_scene_by_hand() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))

    def run(policy: str, scene: str, observed: int) -> dict[str, str]:
        usual = {"seed": "0", "ended_frame": "", "budget": "400", "curve": f"50 60 70 {observed}"}
        return usual | {"policy": policy, "scene": scene, "observed": str(observed)}

    lines = [
        run("naruto", "x", 80), run("random?views_of=naruto", "x", 70),
        run("naruto", "y", 90), run("random?views_of=naruto", "y", 94),
        run("gavis", "x", 85), run("hole_area", "y", 60), run("random", "y", 50),
        run("hole_area", "x", 70) | {"curve": ""}, run("random", "x", 65),
    ]  # fmt: skip
    lines += [run(name, "y", 50) for name in ("frontier", "rt_guide")]  # y has most planners, so it is first
    heads, _, *body = script["by_scene"](lines).splitlines()
    assert heads == "| planner | `y` | `x` | minus chance, mean of the scenes |"
    assert body == [
        "| `naruto` | 90.0 (-4.0) | 80.0 (+10.0) | +3.0 [-4.0, 10.0] |",
        "| `hole_area` | 60.0 (+10.0) | 70.0 | +10.0 |",
        "| `random` | 50.0 | 65.0 |  |",
        "| `frontier` | 50.0 |  |  |",
        "| `rt_guide` | 50.0 |  |  |",
        "| `gavis` |  | 85.0 |  |",
    ]


def test_a_table_of_papers_by_hand() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    nothing = {key: "" for key in script["SHOWN"]}
    lines = [
        nothing | {"policy": "naruto", "scene": "x", "naruto/completion_ratio": "93.94"},
        nothing | {"policy": "random?views_of=naruto", "scene": "x", "naruto/completion_ratio": "95.8"},
        nothing | {"policy": "anm_s", "scene": "x", "activesplat/completion_ratio": "95.2"},
        nothing | {"policy": "anm_s", "scene": "y", "activesplat/completion_ratio": "91"},
        nothing | {"policy": "hole_area", "scene": "y", "activesplat/completion_ratio": "99"},  # no published value
    ]
    assert script["of_papers"](lines).splitlines() == [
        "| planner | protocol | `x` | `y` | Replica | Matterport3D |",
        "|---|---|---:|---:|---:|---:|",
        "| `activegamer` | `activegamer` |  |  | 96.59 | 94.63 |",
        "| `activesplat` | `activesplat` |  |  | 93.64 | 84.81 |",
        "| `anm_s` | `activesplat` | 95.2 | 91.0 | 93.35 | 85.93 |",
        "| `naruto` | `naruto` | 93.9 (95.8) |  | – | 86.39 |",
    ]


def test_our_columns_of_table_3_are_those_of_the_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    page = (ROOT / "docs" / "notebook" / "ablation.md").read_text(encoding="utf-8")
    told = " ".join(page.split())
    ladder = script["read"](script["PLACE"].with_name("ladder_pixels_2000.csv"))
    native = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    paper = native["by_policy"](native["rows"](native["PLACE"].with_name("paper.csv")))

    def mean(name: str, key: str, *, without: str = "-") -> float:
        of = {cell: run[key] for cell, run in ladder[name].items() if not cell[0].startswith(without)}
        return float(script["_mean"](of))

    names = ("pixel_only", *LADDER[1:])
    large = [float(np.mean([float(row["psnr"]) for row in paper[name].values()])) for name in LADDER]
    small = [mean(name, "psnr") for name in names]
    for letter, name, ours, theirs in zip("ABCDE", names, small, large):
        (row,) = (line for line in page.splitlines() if line.startswith(f"| {letter} |") and line.count("|") == 8)
        assert row.endswith(f"| {mean(name, 'completion_ratio'):.1f} | {ours:.2f} | {theirs:.2f} |")
    assert f"{small[4] - small[3]:+.2f} and {large[4] - large[3]:+.2f} dB here" in told
    calm = [mean(name, "psnr", without="hotel_room") for name in names]
    assert f"the steps to C and D cost {calm[1] - calm[2]:.2f} and {calm[2] - calm[3]:.2f} dB" in told


def test_every_threshold_that_is_a_guess_is_there() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "thresholds.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    for guesses in script["GUESSES"].values():
        for words, (module, constant) in guesses.items():
            assert f"{words} | {getattr(module, constant):.3g} |" in told, words


def test_the_native_table_is_that_of_its_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    assert script["of_papers"](script["rows"]()) in told, "paste what native_table.py prints"
    for place in (script["PLACE"], script["PLACE"].with_name("paper.csv")):
        assert all(table in told for table in script["tables"](place).values()), "paste what native_table.py prints"
        for row in script["rows"](place):  # or what is said of it would be of another schedule
            policy = row["policy"].removeprefix(script["FLOOR"]).partition("?")[0]
            settings = POLICIES.get(policy).native_settings
            mapper = configure("full", settings.overrides()).mapper
            assert (row["mapper"], row["iterations"]) == (mapper.name, str(mapper.iterations)), row["policy"]


def test_what_is_said_of_the_paper_s_size_is_that_of_its_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    told = " ".join((ROOT / "docs" / "notebook" / "native.md").read_text().replace("−", "-").split())
    runs = {
        (row["policy"], row["scene"], row["seed"]): float(row["psnr"])
        for row in script["rows"](script["PLACE"].with_name("paper.csv"))
    }
    a, b, c, d, full = LADDER

    def less(one: str, other: str, scene: int, seed: str = "0") -> float:
        return runs[one, f"room?seed={scene}", seed] - runs[other, f"room?seed={scene}", seed]

    def both(one: str, other: str, form: str = ".2f") -> str:
        return f"{less(one, other, 11):{form}} and {less(one, other, 12):{form}} dB"

    differ = f"{less(full, a, 11):+.2f} dB in one room, {less(full, a, 12):+.2f} dB in the other"
    assert f"between the full model (E) and A was resolved**: {differ}" in told
    assert f"With seed 1 in `room?seed=12` it has {less(full, a, 12, '1'):+.2f} dB" in told
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").replace("−", "-").split())
    differ = f"{less(full, a, 11):+.2f}, {less(full, a, 12):+.2f} and {less(full, a, 12, '1'):+.2f} dB in three pairs"
    assert f"simplest variant was resolved**: {differ}" in readme
    assert f"cost {both(a, b)}** (B minus A); their surprise and the discount another {both(b, c)} (C minus B)" in told
    assert less(c, d, 11) == 0.0 and f"D has {less(d, c, 12):.2f} dB more than C" in told
    assert f"bring {both(full, d)}** (E minus D)" in told
    plain = f"{full} [revisit_rounds=1]"
    assert f"bring {both(full, plain, '+.2f')}** (E minus E with" in told
    assert f"A minus D is {less(a, d, 11):.2f} and {less(a, d, 12):.2f} dB" in told
    pairs = [("room?seed=11", "0"), ("room?seed=12", "0"), ("room?seed=12", "1")]
    rows = script["rows"](script["PLACE"].with_name("paper.csv"))
    lines = {(row["policy"], row["scene"], row["seed"]): row for row in rows}
    phases, settled = ([f"{float(lines[full, *pair][key]):.0f}" for pair in pairs] for key in ("phase_2", "settled"))
    assert f"Phase II begins at frame {phases[0]}, {phases[1]} and {phases[2]}" in told
    assert f"From frame {settled[0]}, {settled[1]} and {settled[2]} on E scores views as A does" in told
    for pair in pairs:  # points of the stored curves are 50 frames apart
        same, other = (lines[name, *pair]["curve"].split() for name in (full, a))
        assert same[:6] == other[:6] and "the same observed share up to frame 300" in told
    best = {scene: max(LADDER, key=lambda rung: less(rung, a, scene)) for scene in (11, 12)}
    assert best == {11: full, 12: a}


def test_what_is_said_of_native_runs_is_that_of_the_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    told = " ".join((ROOT / "docs" / "notebook" / "native.md").read_text(encoding="utf-8").split())
    scenes = ("apartment?rooms=3&seed=14", "houses_20_house_5")
    runs = {(row["policy"], row["scene"]): row for row in script["rows"]() if row["scene"] in scenes}

    def spread(*names: str) -> list[float]:
        leads = []
        for name in names:
            chance = script["chance_of"](name, {policy for policy, _ in runs})
            for scene in (scene for scene in scenes if (name, scene) in runs and (chance, scene) in runs):
                end = float(runs[name, scene]["ended_frame"] or runs[name, scene]["budget"])
                leads.append(
                    script["_until"](runs[name, scene], end)[0] - script["_until"](runs[chance, scene], end)[0]
                )
        assert len(leads) >= len(names)
        return [min(leads), max(leads)]

    low, high = spread("active_gs", "frontier", "r3_recon")
    assert f"end {low:.1f} to {high:.1f} points above chance** on their short moves" in told
    low, high = spread("hole_area", "unknown_volume", "unseen", "learned")
    assert f"Our planners of unseen space end {low:.1f} to {high:.1f} points above chance**" in told
    low, high = spread("naruto", "activesplat", "anm_s", "activeinr", "aiisrfe")
    assert f"end {low:+.1f} to {high:+.1f} points from chance on their views**" in told

    def observed(name: str, scene: str) -> str:
        return f"{float(runs[name, scene]['observed']):.1f} %"

    chance = observed(script["FLOOR"] + "naruto", scenes[1])
    assert f"observes {chance} of the house, plain `random` {observed('random', scenes[1])}" in told
    informed = [name for name in ("gauss_mi", "next_best_sense", "fisherrf", "gavis", "view_angle", "fisherrf_path")
                if (name, scenes[0]) in runs]  # fmt: skip
    shares = sorted(observed(name, scenes[0]) for name in informed)
    both = f"`random` {observed('random', scenes[0])} and `hole_area` {observed('hole_area', scenes[0])}"
    assert (
        f"observes {shares[0].removesuffix(' %')} to {shares[-1]} of the apartment after 2,000 frames**, {both}" in told
    )
    assert observed("fisherrf_path", scenes[0]) == shares[-1] and "The highest is `fisherrf_path`" in told


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
    assert all(script["differences"](file) in told for file in script["PHASES"]), "paste what --phases prints"


def test_learning_has_the_runs_of_the_learned_policies() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    told = (ROOT / "docs" / "notebook" / "learning.md").read_text()
    assert script["learned"]() in told, "paste what --learned prints"


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


def test_tables_of_the_notebook_say_what_they_lack() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    run, checkpoint = dict.fromkeys(script["KEPT"], 1.0), "learned:d300@44f39cb9"
    table = {"hole_area": {("x", 0): run}, checkpoint: {("x", 0): run}, "learned": {("x", 0): run}}
    for pair in ((checkpoint, "hole_area"), ("hole_area", checkpoint), (checkpoint, "learned")):
        assert script["policies_of"](":".join(pair), table) == pair
    assert script["policies_of"]("nobody:hole_area", table) == ("nobody", "hole_area")
    with pytest.raises(InputError, match="no scene and seed has runs of all policies: hole_area, random"):
        script["markdown"]({"hole_area": {("x", 0): run}, "random": {("x", 1): run}})
    for key in ("depth_l1_cm", "psnr"):
        table["learned"] = {("x", 0): {name: value for name, value in run.items() if name != key}, ("x", 1): {}}
        with pytest.raises(InputError, match=f"'learned' in x with seed 0 has no {key}"):
            script["pairs"](table, [("it", "learned", "hole_area")])
    native = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    lines = [{"policy": policy, "scene": "x", "seed": seed} for policy, seed in (("random", "0"), ("naruto", "1"))]
    with pytest.raises(InputError, match="no scene and seed has runs of all policies: random, naruto"):
        native["by_policy"](lines)


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
    ours = [name for name in POLICIES if POLICIES.get(name).__module__.startswith("activestructure_gym.")]
    assert f"It has {len(ours)} planners" in text  # other tests register policies too
    longer = (ROOT / "docs" / "notebook" / "performance.md").read_text(encoding="utf-8")
    percents = re.findall(r"(?:C.R. is|a room and) ([\d.]+) %", text)
    assert len(percents) == 2 and all(f"| {percent} / " in longer for percent in percents)

    table = script["read"](script["PLACE"])
    page = " ".join((ROOT / "docs" / "notebook" / "benchmark.md").read_text(encoding="utf-8").split())
    unseen = {"activestructure", "unknown_volume", "unseen", "learned", "magician", "gs_planner", "hgs_planner"}
    unseen |= {"hole_area", "frontier", "active_gs", "r3_recon", *(name for name in table if name.endswith("_cov"))}
    informed = {"fisherrf", "fisherrf_path", "gauss_mi", "next_best_sense", "rt_guide", "activeinr"}
    informed |= {name for name in table if name.startswith("popgs_") and not name.endswith("_cov")}
    shares = {
        name: script["_mean"]({cell: run["observed"] for cell, run in table[name].items()})
        for name in table.keys() - {"random", "reference:oracle"}
    }

    def spread(names: set[str]) -> str:
        return f"{min(shares[name] for name in names):.0f} to {max(shares[name] for name in names):.0f} %"

    lowest = {"popgs_info_trace", "popgs_min_eig", "rt_guide", "activeinr"}
    assert f"such planners observe {spread(unseen)}. Those that score only information" in text
    assert f"in the map observe {spread(informed)}, others {spread(shares.keys() - unseen - informed)}" in text
    assert f"volume of each view observe {spread(unseen)}" in page
    assert f"only information in the map observe {spread(informed)}" in page
    assert f"the others have {spread(informed - lowest)}" in page
    assert f"floor plan, observe {spread(shares.keys() - unseen - informed)}, and `random` 65 %" in page
    houses = script["read"](script["PLACE"].with_name("procthor.csv"))
    assert f"In {len(houses['hole_area'])} published [ProcTHOR houses]" in text

    def difference(file: str, ours: str, theirs: str, key: str) -> str:
        table = script["read"](script["PLACE"].with_name(file))
        return script["_difference"](table, ours, theirs, key, script["OF_PAIRS"][key][1])

    planes = ("headline.csv", "activestructure", "unknown_volume")
    assert f"by {difference(*planes, 'observed_area')} points" in text
    assert f"PSNR changes by {difference(*planes, 'psnr')} dB" in text
    page = " ".join((ROOT / "docs" / "notebook" / "benchmark.md").read_text(encoding="utf-8").split())
    seen = difference("headline.csv", "learned", "unknown_volume", "observed")
    assert f"`learned` minus `unknown_volume` is {seen} points of *observed*" in page
    runs = [script["read"](script["PLACE"].with_name(name)) for name in ("benchmark.csv", "headline.csv")]
    glazed = [
        np.mean([run["psnr"] - table["hole_area"][cell]["psnr"] for cell, run in table["unknown_volume"].items()
                 if cell[0].startswith("hotel_room") and cell in table["hole_area"]])
        for table in runs
    ]  # fmt: skip
    assert "In hotel_room it is {:+.1f} dB in the older runs, {:+.1f} dB in these".format(*glazed) in page
    ours = ("unknown_volume", "activestructure", "learned")
    values = [difference("headline.csv", name, "hole_area", key) for name in ours for key in ("observed_area", "psnr")]
    assert (
        not any("[-" in value for value in values) and "are better than `hole_area`** in exploration and PSNR" in text
    )
    rung, full = "activestructure-d?discovery=hole_area", "activestructure?discovery=hole_area&revisits=true"
    alone = difference("ladder_2000.csv", full, rung, "psnr").removeprefix("+")
    assert f"visible planes costs 0.7 dB, and the phases then gain {alone} dB" in text
    change = difference("phases_2000.csv", *planes[1:], "psnr")
    assert f"PSNR changes by {change} dB in [ten scenes]" in text
    assert f"`unseen` has {difference('phases_300.csv', 'unseen', 'hole_area', 'psnr')} dB" in text
    assert len(script["read"](script["PLACE"].with_name("phases_2000.csv"))["activestructure"]) == 10
    assert f"has {difference('procthor.csv', 'activestructure', 'hole_area', 'psnr')} dB" in text
    calm = difference("phases_rooms.csv", "activestructure", "activestructure?revisits=true", "psnr")
    assert f"a rule of the paper, costs {calm.removeprefix('+')} dB in six rooms" in text
    for base, file in (("hole_area", "ladder_2000.csv"), ("pixel_only", "ladder_pixels_2000.csv")):
        first = "activestructure-b" + ("?discovery=hole_area" if base == "hole_area" else "")
        assert difference(file, first, base, "psnr").startswith(("-0.7", "-0.6"))  # "visible planes cost 0.7 dB"
