"""What the commands print at 80 and at 120 columns: no line is wider, and no number is broken."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shlex
import struct
import sys
import termios
import threading
from pathlib import Path

import numpy as np
import pytest
from rich.cells import cell_len

from activestructure_gym.evaluation.archive import completion, store
from activestructure_gym.evaluation.archive.comparison import open_comparison
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import doctor, main
from activestructure_gym.evaluation.cli.closing import command_lines, print_end
from activestructure_gym.evaluation.cli.compare import Compare, _announce, _with_demo_defaults, comparison_of
from activestructure_gym.evaluation.cli.output import make_console
from activestructure_gym.evaluation.cli.train.live import Live
from activestructure_gym.evaluation.protocols.metrics.standard import STANDARD
from activestructure_gym.evaluation.report.tables.columns import COLUMNS
from activestructure_gym.evaluation.report.tables.overview import table_rows
from activestructure_gym.evaluation.running.comparison import Result
from activestructure_gym.evaluation.running.engines import Outcome
from activestructure_gym.evaluation.running.episode import Progress
from activestructure_gym.evaluation.running.live_progress import LiveProgress
from activestructure_gym.features import FEATURES
from activestructure_gym.policies import POLICIES
from tests.evaluation.written_runs import write_run

WIDTHS, WIDE = (80, 120), 81  # in a terminal of the latter lines may be wider: --wide was asked for
LONG = ("random", "active_gs?travel=shared", "learned:runs/sb3", "popgs_cov_trace_block_cov")
SCENES = ("apartment?rooms=2&seed=13", "/data/a folder/a_very_long_name_of_a_flat_2024.glb?units=cm")
CODES = re.compile(r"\x1b\][^\x1b\x07]*(?:\x1b\\|\x07)|\x1b\[[0-9;?]*[A-Za-z]")

pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="no terminals here")


def seen(width: int, act) -> list[str]:
    """The lines that ``act`` writes to a terminal of this width; those that were overwritten, too."""
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, width, 0, 0))
    said: list[bytes] = []

    def listen() -> None:
        while True:
            try:
                said.append(os.read(ours, 1 << 16))
            except OSError:
                return

    listener = threading.Thread(target=listen)
    listener.start()
    before = sys.stdout
    with pytest.MonkeyPatch.context() as patch, open(theirs, "w", encoding="utf-8") as terminal:
        patch.setenv("COLUMNS", str(width))  # rich asks the terminal that pytest runs in
        patch.setenv("TERM", "xterm-256color")
        sys.stdout = terminal
        try:
            act()
        finally:
            sys.stdout = before
    listener.join()
    os.close(ours)
    lines = re.split(r"\r*\n|\r", CODES.sub("", b"".join(said).decode()))
    assert max(map(cell_len, [line for line in lines if "file://" not in line])) <= width or width == WIDE
    return [line for line in lines if line.strip() and not "⠀" <= line[0] <= "⣿"]  # no spinners


def run(width: int, *words: str, code: int = 0) -> list[str]:
    def act() -> None:
        assert main(list(words)) == code

    return seen(width, act)


def widest(lines: list[str]) -> int:
    return max(map(cell_len, lines))


def numbers_of(k: int) -> dict[str, float | None]:
    """Numbers of many digits, that differ."""
    random = np.random.default_rng(k)
    shares = {key: 100 * random.random() for key in ("observed", "completion_ratio", "tsdf_completion_ratio")}
    frames = {"frames_to_80": 123.0 + k, "frames_to_85": 241.0 if k % 2 else None, "frames_to_90": None}
    metres = {"metres": random.integers(400) / 4, "seconds": 1000 * random.random(), "psnr": 20 + 15 * random.random()}
    return shares | frames | metres | {"frames_to_95": None, "observed_area": 100 * random.random()}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Comparisons on the disk: of one scene and one seed, of one and three seeds, of two scenes and three seeds."""
    places = {}
    for name, scenes, seeds in (("one", ["room"], 1), ("three", ["room"], 3), ("scenes", SCENES, 3)):
        place = tmp_path_factory.mktemp(name) / "runs"
        jobs = [
            Job(scene, policy, seed, scene_hash=f"{k:02x}" * 32)
            for seed in range(seeds) for k, scene in enumerate(scenes) for policy in LONG
        ]  # fmt: skip
        for k, job in enumerate(jobs):
            write_run(place / completion.JOBS / job.name, job, **numbers_of(k))
        record = {"format": store.FORMAT_VERSION, "command": "asg compare", "jobs": {j.name: j.as_dict() for j in jobs}}
        (place / store.COMPARISON).write_text(json.dumps(record))
        places[name] = place
    return places


@pytest.fixture
def undrawn(monkeypatch):
    """The pages are not drawn, which takes most of the time."""
    from activestructure_gym.evaluation.report import summary

    files = [Path("summary.md"), Path("report.html")]
    monkeypatch.setattr(summary, "write_report", lambda directory, *given: [directory / file for file in files])
    monkeypatch.setattr(summary, "write_results", lambda out, results, **given: [out / file for file in files])


@pytest.fixture(autouse=True)
def untried(monkeypatch):
    """No backend is tried, which takes seconds."""
    missing = "package gsplat is missing: pip install 'activestructure-gym[gpu]'"
    rows = [("sensor", "raycast", "works"), ("rasteriser", "cpu", "works"), ("rasteriser", "gsplat", missing)]
    place = "/home/somebody/.cache/activestructure_gym_of_a_long_name"
    rows.append(("cache", place, "cannot be written (Permission denied); everything is computed every time"))
    monkeypatch.setattr(doctor, "_states", lambda: ({"raycast", "cpu"}, rows))


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize(
    "words",
    [
        ["--help"], ["policies"], ["policies", "naruto"], ["policies", "activeinr?uncertainty=proxy"], ["features"],
        ["features", "naruto_look", "hole_area"], ["scenes"], ["scenes", "box"], ["config"], ["config", "fast"],
        ["config", "paper", "planes"], ["doctor"], ["cache"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_lists_fit(width, words):
    lines = run(width, *words)
    assert widest(lines) <= width
    if words == ["policies"]:
        assert len(lines) <= 60 and all(any(line.startswith(f"{name} ") for line in lines) for name in POLICIES)
    if words == ["features"]:
        assert len(lines) <= len(list(FEATURES)) + 6
    if words == ["config", "fast"]:
        assert len(lines) < 200


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["one", "three", "scenes"])
def test_the_result_fits_and_every_number_is_whole(stored, width, name, undrawn, monkeypatch):
    monkeypatch.chdir(stored[name].parent)
    place = Path("runs")
    runs = open_comparison(place)
    lines = seen(width, lambda: print_end(make_console(), Result(runs, [], 0), place, 61.0, None, wide=False))
    commands = lines[lines.index("Next:") :]
    shown = [column for column in COLUMNS if any(column.header in line for line in lines[:5])]
    assert len(shown) >= 5
    rows = [row for row in table_rows(runs) if name != "scenes" or row.scene == "average"]
    for row in rows:
        line = next(line for line in lines if line.startswith(row.policy[:10]))  # a longer name may be folded
        for key, digits in (("observed", 1), ("completion_ratio", 1), ("psnr", 2), ("metres", 1), ("seconds", 0)):
            assert re.search(rf"(?<![\d.]){row.cells[key].mean:.{digits}f}(?![\d.])", line), (key, line)
    said = [shlex.split(line) for line in "\n".join(commands[1:]).replace("\\\n", "").splitlines()]
    assert [words[:2] for words in said][:2] == [["asg", "replay"], ["asg", "watch"]]
    assert len(said[0]) == 4 and all(Path(run).is_dir() for run in said[0][2:])
    assert said[1][-2:] == ["--policy", "you"]
    all_shown = len(shown) == len(COLUMNS) and name != "scenes"
    assert said[2:] == ([] if all_shown else [["asg", "report", "runs", "--wide"]])
    assert any("file:///" in line or "report.html" in line for line in lines)


def test_at_120_columns_there_are_more_columns_and_with_wide_all(stored, undrawn):
    narrow, broad = (run(width, "report", str(stored["one"])) for width in WIDTHS)
    assert widest(broad[:10]) > 80 and not any("SSIM" in line for line in narrow) and any("SSIM" in x for x in broad)
    wide = run(WIDE, "report", str(stored["scenes"]), "--wide")
    assert all(any(column.header in line for line in wide[:6]) for column in COLUMNS)
    assert any("average" in line for line in wide) and any(SCENES[0] in line for line in wide)


@pytest.mark.parametrize("width", WIDTHS)
def test_reports_and_exports_fit(stored, width, tmp_path, monkeypatch, undrawn):
    monkeypatch.chdir(tmp_path)
    assert any("Table 1" in line for line in run(width, "report", str(stored["three"]), "--paper-tables"))
    place = next((stored["one"] / completion.JOBS).iterdir())
    assert "Gaussians of" in " ".join(run(width, "export", str(place), "--out", "m.ply"))


@pytest.mark.parametrize("width", WIDTHS)
def test_what_is_announced_fits_and_names_the_frames(width):
    options = _with_demo_defaults(Compare())

    def act() -> None:
        _announce(make_console(), comparison_of(options), tmp, 2, 2, demo=True)

    tmp = Path("runs/20261231-235959")
    lines = seen(width, act)
    assert widest(lines) <= width and "300 frames per run" in " ".join(lines)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_progress_of_a_comparison_fits_and_keeps_numbers_with_their_units(width):
    jobs = [Job(SCENES[0], policy, seed) for policy in LONG for seed in (0, 12)]

    def act() -> None:
        with LiveProgress(make_console()) as live:
            live.begin(jobs, 3)
            for job in jobs:
                live.progress(job, Progress("exploring", 1, 300, 0.0))
                live.progress(job, Progress("exploring", 123, 300, 87.4))
            live._began -= 3000.0
            live._display.refresh()
            live.ended(Outcome(jobs[0]))
            live.ended(Outcome(jobs[1], "RuntimeError: the way is lost, and more than a line of it " * 2))
            live.on_retry(jobs[2], "killed by signal 9")

    lines = seen(width, act)
    assert widest(lines) <= width
    text = "\n".join(lines)
    assert "123/300" in text and re.search(r"\d:\d\d left", text) and not re.search(r"^\s*(left|s|%)\s*$", text, re.M)
    assert re.search(r"123/300 frames  C\.R\.  87\.4 %  \d+ s", text)


@pytest.mark.parametrize("width", WIDTHS)
def test_the_progress_of_a_training_fits(width):
    row = {"train/loss": 0.12345, "train/agreement": 0.98765, "rollout/reward_per_episode": 12.345}
    row |= {"train/approx_kl": 0.0123, "validation/normalised": 0.812, "validation/auc": 0.671}

    def act() -> None:
        with Live(make_console()) as live:
            live.begin("demonstrations of unknown_volume", 1000, 0, 64)
            live.say("48 policies each, 2 at a time, and more of it")
            live._progress.refresh()
            live.unit(512, row)
            live._progress.refresh()

    lines = seen(width, act)
    assert widest(lines) <= width and "0.812" in "\n".join(lines)


@pytest.mark.parametrize("width", WIDTHS)
def test_measured_rows_are_parted_and_not_cut(width, monkeypatch):
    from activestructure_gym.evaluation.benchmarks import sensors

    rows = [
        {"scene": f"apartment?rooms={k}&seed=13", "size": (160, 90)} | {f"part {n}": 1000.0 + n for n in range(14)}
        for k in (2, 3)
    ]
    monkeypatch.setattr(sensors, "run_sensor_benchmark", lambda scenes: rows)
    lines = run(width, "bench", "sensor")
    assert widest(lines) <= width
    assert all(sum(str(1000 + n) in line for line in lines) == 2 for n in range(14))


@pytest.mark.parametrize("width", WIDTHS)
def test_numbers_measured_again_fit(width):
    from activestructure_gym.evaluation.cli.evaluate import _table
    from activestructure_gym.evaluation.cli.output import print_whole

    names = [metric.name for metric in STANDARD]
    numbers = [(["apartment?rooms=2 · active_gs?travel=shared · seed 0", "activegamer", "✓"], {})]
    numbers[0][1].update({key: 10.0 + k + 0.123 for k, key in enumerate(names)})
    lines = seen(width, lambda: print_whole(make_console(), _table("again", ["run", "protocol", "same"], numbers)))
    assert widest(lines) <= width
    assert all(any(f"{10 + k + 0.123:.4g}" in line for line in lines) for k in range(len(names)))


def test_a_command_goes_on_behind_backslashes():
    words = ["asg", "replay", "runs/20260101-120000/jobs/room--random--seed-0", "runs/a folder/jobs/b"]
    assert command_lines(words, None) == [f"  asg replay {words[2]} 'runs/a folder/jobs/b'"]
    lines = command_lines(words, 70)
    assert lines == ["  asg replay runs/20260101-120000/jobs/room--random--seed-0 \\", "    'runs/a folder/jobs/b'"]
    first, second, third = command_lines(words[:3], 40)
    assert (first, second) == ("  asg replay \\", "    runs/20260101-120000/jobs/\\")
    assert third == "room--random--seed-0"


def test_in_a_pipe_there_is_a_line_per_entry_without_padding(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    for words, count in ((["policies"], len(list(POLICIES))), (["config", "fast"], 150)):
        assert main(words) == 0
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) >= count and not any(line.endswith(" ") or " " * 60 in line for line in lines)
        assert not any("…" in line for line in lines)


def test_the_code_s_checksum_is_short_in_the_table_and_whole_in_json(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["doctor"]) == 0
    assert not re.search(r"[0-9a-f]{20}", capsys.readouterr().out)
    assert main(["doctor", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["versions"]["code"]) == 64
