import dataclasses
import errno
import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.archive.store import COMPARISON
from activestructure_gym.evaluation.cli import compare as module
from activestructure_gym.evaluation.cli import main, replay
from activestructure_gym.evaluation.cli.compare import Compare
from activestructure_gym.evaluation.running import comparison
from activestructure_gym.evaluation.running.comparison import Comparison, Result
from activestructure_gym.evaluation.running.engines import Limits, Outcome
from activestructure_gym.splatting import rasterizers
from activestructure_gym.splatting.backends import BACKENDS


def test_without_options_it_is_the_demo(asked, capsys):
    assert main(["compare"]) == 0
    wanted, (_, directory, options) = asked
    assert (wanted.scenes, wanted.policies, wanted.seeds) == (("room",), ("random", "activestructure"), (0,))
    assert (wanted.conditions.preset, wanted.conditions.frame_budget) == ("default", None)  # the preset's 300
    assert (wanted.conditions.protocol.views, wanted.conditions.protocol.surface_samples) == (16, 50_000)
    assert directory.parts[0] == "runs" and options["engine"] == "local"
    said = " ".join(capsys.readouterr().out.split())
    assert "one run, shared setup, preset default, 300 frames, into runs" in said
    assert "The demo is measured on 16 views and 50,000 points" in said and "on 64 and 200,000" in said


def test_the_demo_can_be_changed_in_part():
    changed = module._with_demo_defaults(Compare(policies=("random",), frames=20))
    assert (changed.scenes, changed.frames, changed.policies) == (("room",), 20, ("random",))
    assert module._with_demo_defaults(Compare(preset="fast")).frames is None
    assert module._with_demo_defaults(Compare(set=("frame_budget=30",))).frames is None
    native = module.comparison_of(module._with_demo_defaults(Compare(policies=("random",), setup="native")))
    assert (native.conditions.preset, native.conditions.frame_budget) == ("full", None)


def test_all_options_arrive(asked):
    words = (
        "compare --scenes box,room?seed=2 --policies random --seeds 1,2 --preset fast --frames 50 --out here "
        "--engine inline --workers 3 --set sensor.width=64 views.max_candidates=9 --views 5 --start 1,2,1.5,90"
    )
    assert main(words.split()) == 0
    wanted, (_, directory, options) = asked
    assert wanted.scenes == ("box", "room?seed=2") and wanted.seeds == (1, 2)
    assert dict(wanted.conditions.overrides) == {"sensor.width": 64, "views.max_candidates": 9}
    assert wanted.conditions.start_pose == (1.0, 2.0, 1.5, 90.0) and wanted.conditions.protocol.views == 5
    assert str(directory) == "here" and options["engine"] == "inline" and options["limits"] == Limits(workers=3)


def test_ctrl_c_says_how_to_go_on(asked, monkeypatch, capsys):
    def interrupted(jobs, directory, listener, **options):
        (directory / COMPARISON).touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison, "run_comparison", interrupted)
    assert main(["compare", "--scenes", "box", "--out", "here"]) == 130
    assert capsys.readouterr().err.endswith("asg compare --out here --resume\n")
    assert main(["compare", "--scenes", "box", "--policies", "my_policy:Mine", "--out", "mine"]) == 130
    assert capsys.readouterr().err.endswith("asg compare --out mine --resume --trust-code\n")  # else it is refused
    assert main(["explore", "--world", "simulated?scene=box", "--out", "world"]) == 130
    assert capsys.readouterr().err.endswith("asg explore --out world --resume\n")


def test_sigterm_ends_as_ctrl_c_does(asked, monkeypatch, capsys):
    def terminated(jobs, directory, listener, **options):
        (directory / COMPARISON).touch()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10)

    monkeypatch.setattr(comparison, "run_comparison", terminated)
    before = signal.getsignal(signal.SIGTERM)
    assert main(["compare", "--scenes", "box", "--out", "here"]) == 143
    assert "finished runs are kept, go on with: asg compare --out here --resume" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_full_disk_says_what_could_not_be_written_and_how_to_go_on(asked, monkeypatch, capsys):
    def full(jobs, directory, listener, **options):
        (directory / COMPARISON).touch()
        raise OSError(errno.ENOSPC, "No space left on device", "here/compare.json")

    monkeypatch.setattr(comparison, "run_comparison", full)
    assert main(["compare", "--scenes", "box", "--out", "here"]) == 1
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "asg: stopped; finished runs are kept, go on with: asg compare --out here --resume",
        "asg: 'here/compare.json' cannot be written: No space left on device",
    ]


def test_failed_runs_end_with_one(asked, monkeypatch, capsys):
    failed = Result([], [Outcome(Job("box", "random", 0), "broken")], 0)
    monkeypatch.setattr(comparison, "run_comparison", lambda *arguments, **options: failed)
    assert main(["compare", "--scenes", "box", "--out", "here"]) == 1
    assert "1 run failed" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, message",
    [
        ("--engine lokal", "unknown engine 'lokal'; did you mean 'local'"),
        ("--timeout-min -2", "--timeout-min must be a number from 0 to 525600, got -2"),
        ("--retries -1", "--retries must be a whole number from 0 to 1000, got -1"),
        ("--workers -1", "--workers must be a whole number from 0 to 4096, got -1"),
        ("--engine inline --timeout-min 3", "engine 'inline' cannot stop a run"),
        ("--set mapper.backend=foo", "unknown splatting backend 'foo'"),
        ("--set mapper.keyframe_reduction=0", "keyframe_reduction must be a whole number from 1 to 64, got 0"),
        ("--set mapper.keyframe_reduction=-1", "keyframe_reduction must be a whole number from 1 to 64, got -1"),
        ("--set mapper.keyframe_reduction=2.5", "keyframe_reduction must be a whole number, got 2.5"),
        ("--set mapper.keyframe_reduction=x", "keyframe_reduction must be a whole number, got 'x'"),
        ("--views 0", "views must be"),
        ("--samples 0", "surface_samples must be"),
        ("--references foo", "unknown reference 'foo'. Known: oracle, oracle-quality"),
        ("--references oracle --policies oracle", "unknown policy 'oracle'"),
        ("--policies reference:oracle", "ask for it by --references oracle"),
        ("--resume --out here", "there is no comparison in 'here' to go on with"),
    ],
)
def test_mistakes_are_one_sentence_and_leave_no_folder(words, message, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", *words.split()]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_a_backend_that_cannot_run_here_is_refused_before_anything_is_prepared(monkeypatch, tmp_path, capsys):
    rasterizers.rasterizer.cache_clear()
    missing = dataclasses.replace(BACKENDS.get("gsplat"), status=lambda: "it is not here")
    monkeypatch.setitem(BACKENDS._entries, "gsplat", missing)
    monkeypatch.setattr(Comparison, "prepare", lambda self, notify: pytest.fail("prepared"))
    monkeypatch.chdir(tmp_path)
    assert main("compare --scenes box --policies random --set mapper.backend=gsplat".split()) == 2
    said = capsys.readouterr().err
    assert "splatting backend 'gsplat' cannot run here (it is not here)" in said and said.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_without_ray_its_engine_says_what_to_install(monkeypatch, tmp_path, capsys):
    import importlib.util

    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "ray" else found(name, *rest))
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "--engine", "ray"]) == 2
    assert "pip install 'activestructure-gym[ray]'" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_what_is_compared_has_a_default_that_nobody_can_type():
    manner = {"out", "resume", "dry_run", "engine", "workers", "shard", "timeout_min", "retries", "replay", "baseline"}
    manner |= {"trust_code", "wide"}
    defaults = {name: value for name, value in vars(Compare()).items() if name not in manner}
    assert {name for name, value in defaults.items() if value not in (None, ())} == set()
    assert not module._typed(Compare(), *defaults)
    for name, value in (("seeds", ("0",)), ("setup", "shared"), ("view_source", "free_space")):
        assert module._typed(Compare(**{name: value}), name)


def test_what_was_not_typed_is_as_usual_and_help_says_so(asked, capsys):
    usual = module.comparison_of(Compare())
    assert (usual.scenes, usual.policies, usual.seeds) == (("room",), ("random", "activestructure"), (0,))
    assert usual == Comparison(["room"], ["random", "activestructure"])
    assert main(["compare", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for default in ("random activestructure", "0", "shared", "standard", "free_space", "room", "64"):
        assert f"(default: {default})" in shown
    assert "--setup {shared,native}" in shown and "--view-source {free_space,recorded}" in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--policies", "--policies lacks a value"),  # of a variable that is empty, say
        ("--seeds", "--seeds lacks a value"),
        ("--policies None", "unknown policy 'None'"),
        ("--setup None", "invalid choice 'None' for argument '--setup'"),
    ],
)
def test_an_option_without_a_value_is_typed_and_none_is_no_word(asked, capsys, words, message):
    assert main(["compare", *words.split()]) == 2
    assert message in capsys.readouterr().err and not asked


def test_the_baseline_must_take_part(asked, capsys):
    assert main("compare --scenes box --policies random --baseline pixel_only --out here".split()) == 2
    assert "--baseline is one of the policies, random; got 'pixel_only'" in capsys.readouterr().err
    assert not asked  # neither prepared nor run


def test_a_sweep_is_an_axis_of_the_comparison(asked, capsys):
    words = "compare --scenes box --policies random --set sensor.width=96 --out here"
    sweep = "--sweep mapper.seed_spacing=0.06,0.12 --sweep sensor.depth_noise=none,kinect"
    assert main(f"{words} {sweep} --dry-run".split()) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 seed x 2 values of mapper.seed_spacing x 2 values of sensor.depth_noise, shared setup" in said
    assert said.count("random [mapper.seed_spacing=0.06, sensor.depth_noise=") == 2
    row = "random [mapper.seed_spacing=0.12, sensor.depth_noise=none]"
    assert main([*f"{words} {sweep} --dry-run --baseline".split(), row]) == 0
    assert main(f"{words} --sweep frame_budget=20,40 --dry-run".split()) == 0
    assert "20 or 40 frames per run" in capsys.readouterr().out
    for wrong, message in (
        ("--sweep sensor.width=64,96", "sensor.width is swept and also set to one value for all runs"),
        ("--frames 9 --sweep frame_budget=20,40", "frame_budget is swept and also set to one value"),
        ("--sweep mapper.spacing=1,2", "did you mean 'seed_spacing'"),
        ("--sweep sensor.height=54,64 --baseline no", "random, random [sensor.height=54], random [sens"),
        ("--sweep sensor.height=54,54", "the sweep of sensor.height has a value twice: 54, 54"),
    ):
        assert main(f"{words} {wrong} --dry-run".split()) == 2
        assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("jobs", [1, 2])
def test_markup_in_a_directory_s_name_is_shown_as_it_is(jobs):
    import io

    from rich.console import Console

    from activestructure_gym.evaluation.cli.compare import _announce
    from activestructure_gym.evaluation.running.comparison import Comparison

    out = io.StringIO()
    comparison = Comparison(scenes=["box"], policies=["random"])
    _announce(Console(file=out, width=300), comparison, Path("runs/[red]a[/bold]"), jobs, 1, demo=False)
    assert "into runs/[red]a[/bold]" in out.getvalue()


def test_replays_are_made_where_they_are_asked_for_and_missing(asked, monkeypatch, tmp_path, capsys):
    made = []

    def write_page(console, page, runs, *, trusted):
        assert trusted  # they are the user's own
        if page.parent.name == "gone":
            raise InputError("its scene is not there any more")
        made.append((page, runs))

    monkeypatch.setattr(replay, "write_page", write_page)
    job = SimpleNamespace(title="box · random · seed 0")
    runs = [SimpleNamespace(directory=tmp_path / name, job=job) for name in ("gone", "old", "new")]
    for run in runs:
        run.directory.mkdir()
    (runs[1].directory / "replay.html").write_text("made before")
    monkeypatch.setattr(comparison, "run_comparison", lambda *given, **options: Result(runs, [], 0))
    before = []
    monkeypatch.setattr(module, "print_end", lambda *given, **options: before.append(len(made)) or 0)
    assert main(["compare", "--replay"]) == 0
    assert before == [1]  # the report links to them
    assert made == [(runs[2].directory / "replay.html", [runs[2]])]
    assert "no replay of box · random · seed 0: its scene is not there" in capsys.readouterr().out
    assert main(["compare"]) == 0
    assert len(made) == 1


def test_a_dry_run_lists_the_runs_and_writes_nothing(asked, tmp_path, capsys):
    words = "--scenes box,room --policies hole_area --references oracle --seeds 0,1 --frames 40 -o here --dry-run"
    assert main(["compare", *words.split()]) == 0 and not asked and not list(tmp_path.iterdir())
    said = capsys.readouterr().out
    assert "2 scenes x 2 policies x 2 seeds" in said and "40 frames per run, into here" in said
    assert said.count("hole_area") == 4 and said.count("oracle") == 4 and "Nothing was run (--dry-run)" in said
    assert main(["compare", *words.split(), "--shard", "2/4"]) == 0
    said = capsys.readouterr().out
    assert said.count("oracle") == 2 and "hole_area" not in said and not list(tmp_path.iterdir())
    assert main(["compare", "--policies", "nobody", "-n"]) == 2
    assert main(["compare", "--scenes", "nowhere", "-n"]) == 2
    assert "unknown scene 'nowhere'" in capsys.readouterr().err
