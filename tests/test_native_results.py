"""What the pages say of runs in the native setup and at the paper's size is what their files hold."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

from activestructure_gym.config import configure
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.activestructure import LADDER

ROOT = Path(__file__).resolve().parents[1]


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
    assert (first[column], second[column]) == ("+2.0 [-10.7, 14.7]", "")


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
        "| `naruto` | 90.0 (-4.0) | 80.0 (+10.0) | +3.0 |",
        "| `hole_area` | 60.0 (+10.0) | 70.0 | +10.0 |",
        "| `random` | 50.0 | 65.0 |  |",
        "| `frontier` | 50.0 |  |  |",
        "| `rt_guide` | 50.0 |  |  |",
        "| `gavis` |  | 85.0 |  |",
    ]


def test_rows_that_precede_a_change_are_marked() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    assert script["OUTDATED"] <= set(POLICIES)
    script["marked"].__globals__["OUTDATED"] = {"popgs_logdet", "rt_guide"}
    table = "| `naruto` | 90.0 (-4.0) |\n| `popgs_logdet` | 50.0 |\n| `rt_guide` | 50.0 |\n"
    assert script["marked"](table) == table.replace("logdet`", "logdet` †").replace("guide`", "guide` †")


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


def test_every_threshold_that_is_a_guess_is_there() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "thresholds.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    for guesses in script["GUESSES"].values():
        for words, (module, constant) in guesses.items():
            assert f"{words} | {getattr(module, constant):.3g} |" in told, words


def test_the_native_table_is_that_of_its_runs() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    told = (ROOT / "docs" / "notebook" / "native.md").read_text()
    assert script["marked"](script["of_papers"](script["rows"]())) in told, "paste what native_table.py prints"
    house = told.partition("## All measures in the house")[2].lstrip()
    assert house.startswith(f"`{script['WHOLE']}`.") and script["tables"]()[script["WHOLE"]] in house
    # The picture is that of the house, as its caption says.
    assert script["drawn"]() == script["PICTURE"].read_text(encoding="utf-8")
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
    told = " ".join((ROOT / "docs" / "notebook" / "native.md").read_text(encoding="utf-8").replace("−", "-").split())
    scenes = ("apartment?rooms=3&seed=14", "houses_20_house_5", "room?seed=12")
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

    low, high = spread("active_gs")
    assert f"`active_gs` ends {low:.1f} to {high:.1f} points above chance on its short moves**" in told
    low, high = spread("frontier", "r3_recon")
    assert f"`frontier` and `r3_recon` {low:.1f} to {high:.1f}." in told
    low, high = spread("gs_planner", "hgs_planner")
    assert f"`gs_planner` and `hgs_planner` end {low:.1f} to {high:.1f} points above chance on their views." in told
    low, high = spread("gavis", "next_best_sense", "popgs_cov_trace", "popgs_logdet")
    words = f"`popgs_cov_trace` and `popgs_logdet` end {low:.1f} to {high:.1f} points above chance on their views**"
    assert f"`gavis`, `next_best_sense`, {words}" in told
    low, high = spread("fisherrf", "view_angle")
    assert f"`fisherrf` and `view_angle` {low:.1f} to {high:+.1f}. The control" in told
    low, high = spread("popgs_info_trace")
    assert f"`popgs_info_trace` ends {-high:.1f} to {-low:.1f} below" in told
    low, high = spread("gauss_mi")
    assert f"`gauss_mi` ends {low:.1f} to {high:.1f} points above chance on its moves.**" in told
    low, high = spread("hole_area", "unknown_volume", "unseen", "learned")
    assert f"Our planners of unseen space end {low:.1f} to {high:.1f} points above chance**" in told
    low, high = spread(*(f"activestructure{variant}" for variant in ("", "-a", "-b", "-c", "-d")))
    assert f"`activestructure` and its variants {low:.1f} to {high:.1f}." in told
    low, high = spread("naruto", "anm_s", "activesplat")
    assert f"`naruto`, `anm_s` and `activesplat` end {low:+.1f} to {high:+.1f} points from chance" in told
    low, high = spread("activeinr", "rt_guide")
    assert f"`activeinr` and `rt_guide` end {-high:.1f} to {-low:.1f} points below chance" in told

    def observed(name: str, scene: str) -> str:
        return f"{float(runs[name, scene]['observed']):.1f} %"

    in_a_room = [float(share) for share in runs["rt_guide", scenes[0]]["curve"].split()[650 // 50 - 1 : 1300 // 50]]
    page = " ".join((ROOT / "policies" / "rt_guide" / "README.md").read_text(encoding="utf-8").split())
    assert f"is {min(in_a_room):.0f} to {max(in_a_room):.0f} % from frame 650 to 1,300" in page

    chance = observed(script["FLOOR"] + "naruto", scenes[1])
    assert f"observes {chance} of the house, `random` {observed('random', scenes[1])}" in told


def test_the_statements_have_the_numbers_of_the_runs() -> None:
    native = runpy.run_path(str(ROOT / "docs" / "notebook" / "native_table.py"))
    shared = runpy.run_path(str(ROOT / "docs" / "notebook" / "benchmark_table.py"))
    told = (ROOT / "docs" / "notebook" / "statements.md").read_text(encoding="utf-8").replace("−", "-")
    runs = {row["policy"]: row for row in native["rows"]() if row["scene"].startswith("apartment")}
    table = shared["_pooled"](shared["read"](shared["PLACE"]))  # with the variants of planners
    for name, other in shared["STATEMENTS"].items():
        (row,) = (line for line in told.splitlines() if line.startswith(f"| `{name}` |") and line.count("|") == 6)
        ours, theirs = (float(runs[one]["observed"]) for one in (name, other))
        assert f"| {shared['statement'](name)} | {ours:.1f}, {theirs:.1f} |".replace("−", "-") in row, name
        # A single run hints at something only if it differs by more than two starts do.
        verdict = row.split("|")[-2]
        assert ("native: " in verdict) == (abs(ours - theirs) > 6.3), name
        assert ("native: no" in verdict) == (theirs - ours > 6.3), name
        ratio = shared["_paired"](table, name, other, "completion_ratio").difference
        expected = "yes" if ratio.low > 0 else "no" if ratio.high < 0 else "open"
        assert re.split("[,:;]", verdict.partition("shared: ")[2])[0].strip() == expected, name

    def difference(ours: str, theirs: str, key: str) -> str:
        return str(shared["_difference"](table, ours, theirs, key, shared["OF_PAIRS"][key][1]))

    rows = {line.split(" | ")[0]: line for line in told.splitlines() if line.startswith("| `") and line.count("|") == 6}
    full = ("activestructure", "pixel_only"), ("activestructure", "unknown_volume")
    for pair, row, *keys in (
        *((pair, "| `activestructure`", "observed_area", "psnr") for pair in full),
        *((("magician" + end, "magician?search=greedy" + more), "| `magician`", "completion_ratio", "psnr")
          for end, more in (("", ""), ("?travel=shared", "&travel=shared"))),
        (("hgs_planner", "gs_planner"), "| `gs_planner`, `hgs_planner`", "observed"),
        *((("popgs_" + kind, "fisherrf"), "| `popgs_*`", "completion_ratio", "psnr")
          for kind in ("cov_trace", "logdet", "min_eig")),
    ):  # fmt: skip
        assert all(difference(*pair, key) in rows[row] for key in keys), (pair, row)
    lower = difference("gs_planner", "fisherrf", "observed").removeprefix("+")
    assert f"`fisherrf` {lower} below the first" in rows["| `gs_planner`, `hgs_planner`"]
