import pytest

from activestructure_gym.evaluation import comparison
from activestructure_gym.evaluation.cli import compare as module
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.commands import Compare
from activestructure_gym.evaluation.comparison import Comparison, Result
from activestructure_gym.evaluation.engines import Outcome
from activestructure_gym.evaluation.jobs import Job
from activestructure_gym.evaluation.store import COMPARISON


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """What `run_comparison` is asked for; nothing runs."""
    monkeypatch.chdir(tmp_path)
    calls = []

    def prepare(self, notify):
        calls.append(self)
        return [Job(self.scenes[0], self.policies[0], self.seeds[0])]

    def run(jobs, directory, listener, **options):
        calls.append((jobs, directory, options))
        return Result([], [], 0)

    monkeypatch.setattr(Comparison, "prepare", prepare)
    monkeypatch.setattr(comparison, "run_comparison", run)
    return calls


def test_without_options_it_is_the_demo(asked, capsys):
    assert main(["compare"]) == 0
    wanted, (_, directory, options) = asked
    assert (wanted.scenes, wanted.policies, wanted.seeds) == (("room",), ("random", "pixel_only"), (0,))
    assert (wanted.preset, wanted.frame_budget, wanted.protocol.views) == ("default", 200, 16)
    assert directory.parts[0] == "runs" and options["engine"] == "local"
    assert "demo" in capsys.readouterr().out


def test_the_demo_can_be_changed_in_part():
    changed = module._with_demo_defaults(Compare(policies=("random",), frames=20))
    assert (changed.scenes, changed.frames, changed.policies) == (("room",), 20, ("random",))
    # Another preset has a budget of its own.
    assert module._with_demo_defaults(Compare(preset="fast")).frames is None


def test_all_options_arrive(asked):
    words = (
        "compare --scenes box,room?seed=2 --policies random --seeds 1,2 --preset fast --frames 50 --out here "
        "--engine inline --workers 3 --set sensor.width=64 views.max_candidates=9 --views 5 --start 1,2,1.5,90"
    )
    assert main(words.split()) == 0
    wanted, (_, directory, options) = asked
    assert wanted.scenes == ("box", "room?seed=2") and wanted.seeds == (1, 2)
    assert dict(wanted.overrides) == {"sensor.width": 64, "views.max_candidates": 9}
    assert wanted.start_pose == (1.0, 2.0, 1.5, 90.0) and wanted.protocol.views == 5
    assert str(directory) == "here" and options["engine"] == "inline" and options["workers"] == 3


def test_ctrl_c_says_how_to_go_on(asked, monkeypatch, capsys):
    def interrupted(jobs, directory, listener, **options):
        directory.mkdir()
        (directory / COMPARISON).touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison, "run_comparison", interrupted)
    assert main(["compare", "--scenes", "box", "--out", "here"]) == 130
    assert "--out here --resume" in capsys.readouterr().err


def test_failed_runs_end_with_one(asked, monkeypatch, capsys):
    failed = Result([], [Outcome(Job("box", "random", 0), "broken")], 0)
    monkeypatch.setattr(comparison, "run_comparison", lambda *arguments, **options: failed)
    assert main(["compare", "--scenes", "box", "--out", "here"]) == 1
    assert "1 run failed" in capsys.readouterr().err
