import dataclasses
import json

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.cli import compare as module
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.evaluation.running.engines import Limits
from activestructure_gym.evaluation.running.resuming import merged
from activestructure_gym.registry import TRUST
from tests.evaluation.written_runs import write_comparison


@pytest.mark.parametrize("words", ["", "--preset fast", "--lpips-weights weights", "--view-source free_space"])
def test_where_no_cell_is_named_those_of_the_record_are_gone_on_with_and_no_others(asked, monkeypatch, tmp_path, words):
    monkeypatch.setattr(module, "use_lpips_weights", lambda place: asked.append(place))
    recorded = [
        Job("box", "random", 7, conditions=Conditions(preset="fast")),
        Job("box", "pixel_only", 8, conditions=Conditions(preset="fast")),
    ]  # no product
    write_comparison(tmp_path / "here", recorded)
    assert main(f"compare --out here --resume --workers 1 --retries 4 --timeout-min 9 {words}".split()) == 0
    place, checked, (jobs, _, options) = asked
    assert place == ("weights" if "weights" in words else None) and checked.conditions.preset == "fast"
    assert jobs == recorded and options["resume"]
    assert options["limits"] == Limits(workers=1, timeout_min=9.0, retries=4)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--preset default", "preset was fast, asked for is default"),
        ("--setup shared", "setup was native, asked for is shared"),
        ("--protocols standard", "also was activegamer, asked for is none"),
        ("--view-source free_space", "view_source was recorded, asked for is free_space"),
    ],
)
@pytest.mark.parametrize("cells", ["", "--policies frontier"])
def test_a_condition_that_is_typed_is_not_ignored_where_it_is_the_usual_one(
    asked, tmp_path, capsys, words, message, cells
):
    protocol = dataclasses.replace(StandardProtocol(), view_source="recorded")
    begun = Job(
        "box",
        "random",
        0,
        conditions=Conditions(preset="fast", setup="native", also=("activegamer",), protocol=protocol),
    )
    write_comparison(tmp_path / "here", [begun])
    if cells:  # `run_comparison`, which refuses it, is replaced
        main(f"compare --out here --resume {cells} {words}".split())
        jobs = asked[1][0]
        with pytest.raises(InputError, match=message):
            merged([begun], jobs, tmp_path)
    else:
        assert main(f"compare --out here --resume {words}".split()) == 2
        assert message in capsys.readouterr().err and len(asked) == 1


@pytest.mark.parametrize(
    ("words", "scenes", "policies", "seeds"),
    [
        ("--policies frontier", ("box", "room"), ("frontier",), (3, 4)),
        ("--seeds 7", ("box", "room"), ("random", "hole_area"), (7,)),
        ("--seeds 0", ("box", "room"), ("random", "hole_area"), (0,)),  # as if nothing were typed, for a new one
        ("--policies random pixel_only", ("box", "room"), ("random", "pixel_only"), (3, 4)),
        ("--policies frontier --seeds 0", ("box", "room"), ("frontier",), (0,)),
        ("--scenes apartment", ("apartment",), ("random", "hole_area"), (3, 4)),
        ("--references oracle", ("box", "room"), (), (3, 4)),
        ("--scenes apartment --policies frontier --seeds 5", ("apartment",), ("frontier",), (5,)),
    ],
)
def test_what_is_added_is_under_the_conditions_of_the_record(asked, tmp_path, words, scenes, policies, seeds, capsys):
    protocol = dataclasses.replace(StandardProtocol(), views=3)
    grid = [
        Job(scene, policy, seed, conditions=Conditions("fast", 60, {"mapper.iterations": 2}, protocol=protocol))
        for seed in (3, 4) for scene in ("box", "room") for policy in ("random", "hole_area")
    ]  # fmt: skip
    write_comparison(tmp_path / "here", grid)
    main(f"compare --out here --resume {words}".split())
    wanted = asked[0]
    assert (wanted.scenes, wanted.policies, wanted.seeds) == (scenes, policies, seeds)
    assert (wanted.conditions.preset, wanted.conditions.frame_budget, wanted.conditions.overrides) == (
        "fast",
        60,
        {"mapper.iterations": 2},
    )
    assert wanted.conditions.protocol == protocol and "demo" not in capsys.readouterr().out


@pytest.mark.parametrize("words", ["--policies random", "--seeds 1", "--preset fast", ""])
def test_resume_begins_no_demo_where_there_is_no_comparison(asked, tmp_path, capsys, words):
    assert main(f"compare --out typo --resume {words}".split()) == 2
    assert "there is no comparison in 'typo' to go on with; name --scenes" in capsys.readouterr().err
    (tmp_path / "lost" / "jobs").mkdir(parents=True)  # a record that is lost
    assert main(f"compare --out lost --resume {words}".split()) == 2 and not asked
    assert main(f"compare --out lost --resume --scenes box {words}".split()) == 0 and asked[0].scenes == ("box",)


def test_scenes_of_the_record_are_taken_as_they_stand_there(asked, tmp_path):
    moved = "/gone/k,l/house.obj?up=z"  # was there when the comparison was begun
    write_comparison(tmp_path / "here", [Job(moved, "random", 0, "ab" * 32)])
    assert main("compare --out here --resume --policies frontier".split()) == 0
    assert asked[0].scenes == (moved,) and asked[0].recorded == {moved: "ab" * 32}


def test_mappers_alone_are_added_for_the_trajectories_of_the_record(asked, tmp_path):
    write_comparison(tmp_path / "here", [Job("box", policy, 0) for policy in ("random", "trajectory:sweep")])
    assert main("compare --out here --resume --mappers splatam".split()) == 0
    assert asked[0].policies == ("trajectory:sweep?mapper=splatam",)


def test_code_that_only_the_record_names_is_refused(asked, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(TRUST, "0")  # the option sets it: so it is what it was when this test ends
    write_comparison(tmp_path / "here", [Job("box", "my_policy:Mine", 0), Job("box", "random", 0)])
    assert main("compare --out here --resume --seeds 4".split()) == 2
    assert "my_policy:Mine" in capsys.readouterr().err and not asked
    assert main("compare --out here --resume --seeds 4 --trust-code".split()) == 0
    monkeypatch.setenv(TRUST, "0")
    assert main("compare --out here --resume --policies my_policy:Mine,frontier".split()) == 0  # the user's own words
    assert [call.policies for call in asked if isinstance(call, Comparison)][-1] == ("my_policy:Mine", "frontier")


def test_another_condition_that_is_given_is_not_ignored(asked, tmp_path):
    write_comparison(tmp_path / "here", [Job("box", "random", 0, conditions=Conditions(preset="fast"))])
    main("compare --out here --resume --policies frontier --preset default --frames 9 --views 2".split())
    assert (asked[0].conditions.preset, asked[0].conditions.frame_budget, asked[0].conditions.protocol.views) == (
        "default",
        9,
        2,
    )  # to be refused


def test_a_sweep_may_grow_when_it_is_resumed(asked, tmp_path):
    jobs = Comparison(["box"], ["random"], sweep={"frame_budget": (20, 40)}).jobs(["random"], {})
    write_comparison(tmp_path / "here", jobs)
    assert main("compare --out here --resume --policies hole_area".split()) == 0
    assert asked[0].sweep == {"frame_budget": (20, 40)} and asked[0].conditions == Conditions()
    assert main("compare --out here --resume --sweep frame_budget=80".split()) == 0
    assert asked[2].sweep == {"frame_budget": (80,)} and asked[2].policies == ("random",)


def test_the_baseline_may_be_of_an_earlier_sitting(asked, tmp_path):
    (tmp_path / "here").mkdir()
    earlier = Job("box", "pixel_only", 0)
    (tmp_path / "here" / "compare.json").write_text(json.dumps({"jobs": {earlier.name: earlier.as_dict()}}))
    words = "compare --scenes box --policies random --baseline pixel_only --out here --resume"
    assert main(words.split()) == 0 and len(asked) == 2  # prepared and run
