"""The numbers, tables and pictures of README and of the results pages are those of their CSVs."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

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


def test_our_columns_of_table_3_are_those_of_the_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    page = (ROOT / "docs" / "notebook" / "ablation.md").read_text(encoding="utf-8")
    told = " ".join(page.split())
    ladder = script["read"](script["PLACE"].with_name("ladder_2000.csv"))
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


@pytest.mark.parametrize("runs", ["benchmark.csv", "procthor.csv"])
def test_the_tables_of_results_are_those_of_their_runs(runs: str) -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    table = script["read"](script["PLACE"].with_name(runs))
    houses = [("`activestructure` minus `unknown_volume`", "activestructure", "unknown_volume")]
    expected = [script["pairs"](table, houses), script["markdown"](table)]
    if runs == "benchmark.csv":
        expected = [script["headline"](), script["markdown"](script["all_policies"]())]
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
    told = script["readme"](script["read"](script["PLACE"]))
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
    rungs = script["ladder"](table, "pixel_only")
    steps = [(ours, theirs) for _, ours, theirs in rungs]
    assert steps[:4] == list(zip(list(table)[1:], table)) and steps[4] == (list(table)[-1], "pixel_only")
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in script["pairs"](table, rungs).splitlines()]
    columns = [lines[0].index(name) for name in ("pairs", "PSNR (dB)", "better in PSNR", "depth error, ratio")]
    assert [[line[column] for column in columns] for line in lines[2:4]] == [
        ["2", "+1.00 [1.00, 1.00]", "2", "0.50 [0.50, 0.50]"],
        ["2", "-1.00 [-13.71, 11.71]", "0", "2.00 [2.00, 2.00]"],
    ]
    del table["activestructure-c"]
    assert script["ladder"](table, "pixel_only") == []


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

    table = script["all_policies"]()
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
    chance = script["_mean"]({cell: run["observed"] for cell, run in table["random"].items()})
    rest = spread(shares.keys() - unseen - informed)
    assert f"floor plan, observe {rest}, and `random` {chance:.0f} %" in page
    decisions = {
        name: script["_mean"]({cell: run["decisions"] for cell, run in table[name].items()})
        for name in ("hole_area", *(informed - lowest))
    }
    counted = [count for name, count in decisions.items() if name != "hole_area"]
    told = f"only {min(counted):.0f} to {max(counted):.0f} of their decisions, without the controls"
    assert f"{told} (`hole_area`: {decisions['hole_area']:.0f})" in page

    def means(key: str) -> dict[str, float]:
        return {name: script["_mean"]({cell: run[key] for cell, run in runs.items()}) for name, runs in table.items()}

    explored = means("observed_area")
    low, high = explored["random"], explored["reference:oracle"]
    names = ("activestructure", "unknown_volume", "learned", "hole_area")
    scale = "`{}` has {:.2f}, `{}` {:.2f}, `{}` {:.2f} and `{}` {:.2f}.".format(
        *(part for name in names for part in (name, (explored[name] - low) / (high - low)))
    )
    assert f"the one-step oracle (1), {scale}" in page
    less = sorted(explored["hole_area"] - explored[name] for name in table if name.endswith("_cov"))
    assert f"lower means than `hole_area`, by {less[0]:.1f} to {less[-1]:.1f} points" in page and less[0] > 0
    best = (script["_paired"](table, name, "hole_area", key).difference for name in shares.keys() - {"hole_area"}
            for key in ("observed_area", "psnr"))  # fmt: skip
    assert not any(one.low > 0 for one in best) and "**No planner is significantly better than `hole_area`" in page
    fused, plain = means("tsdf_completion_ratio"), means("completion_ratio")
    gap = max(abs(fused[name] - plain[name]) for name in table)
    assert f"The C.R. of the fused surface differs from it by at most {gap:.1f} points" in page
    assert not any(means("collisions").values()) and "No executed step crossed the true mesh" in page
    houses = script["read"](script["PLACE"].with_name("procthor.csv"))
    assert f"In {len(houses['hole_area'])} published [ProcTHOR houses]" in text

    def difference(file: str, ours: str, theirs: str, key: str) -> str:
        table = script["read"](script["PLACE"].with_name(file)) if file else script["all_starts"]()
        return script["_difference"](table, ours, theirs, key, script["OF_PAIRS"][key][1])

    planes = ("", "activestructure", "unknown_volume")
    assert f"by {difference(*planes, 'observed_area')} points" in text
    assert f"PSNR changes by {difference(*planes, 'psnr')} dB" in text
    page = " ".join((ROOT / "docs" / "notebook" / "benchmark.md").read_text(encoding="utf-8").split())
    seen = difference("", "learned", "unknown_volume", "observed").removeprefix("+")
    assert f"`learned` observes {seen} points more than `unknown_volume`" in page
    ours = ("unknown_volume", "activestructure", "learned")
    values = [[difference("", name, "hole_area", key) for name in ours] for key in ("observed_area", "psnr")]
    assert not any("[-" in value for row in values for value in row)
    areas, dbs = (sorted(value.split()[0].removeprefix("+") for value in row) for row in values)
    assert set(areas) == {areas[0]} and "are better than `hole_area`**: with [three sets of starts]" in text
    assert f"(90 pairs) by {areas[0]} points of exploration and {dbs[0]} to {dbs[-1]} dB" in text
    assert {len(runs) for runs in script["all_starts"]().values()} == {90}
    rung, full = "activestructure-d?discovery=hole_area", "activestructure?discovery=hole_area&revisits=true"
    alone = difference("ladder_2000.csv", full, rung, "psnr").removeprefix("+")
    assert f"visible planes costs 0.7 dB, and the phases then gain {alone} dB" in text
    change = difference("phases_2000.csv", *planes[1:], "psnr")
    assert f"PSNR changes by {change} dB in [ten scenes]" in text
    files = ("phases_300.csv", "procthor.csv")
    further = [difference(file, name, "hole_area", "psnr") for file in files for name in ours[:2]]
    assert all(value.startswith("+") and "[-" in value for value in further)
    assert "the first two have higher means, but no difference is significant" in text
    assert len(script["read"](script["PLACE"].with_name("phases_2000.csv"))["activestructure"]) == 10
    calm = difference("phases_rooms.csv", "activestructure", "activestructure?revisits=true", "psnr")
    assert f"a rule of the paper, costs {calm.removeprefix('+')} dB in six rooms" in text
    for base, option in (("hole_area", "?discovery=hole_area"), ("pixel_only", "")):
        cost = difference("ladder_2000.csv", f"activestructure-b{option}", base, "psnr")
        assert cost.startswith(("-0.7", "-0.6"))  # "visible planes cost 0.7 dB"
