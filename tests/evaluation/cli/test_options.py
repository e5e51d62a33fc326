import re

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli.options import (
    parse_labels,
    parse_overrides,
    parse_seeds,
    parse_start,
    parse_sweep,
    split_list,
    split_policies,
    split_scenes,
    start_of,
)
from activestructure_gym.policies import POLICIES
from activestructure_gym.policies.activestructure import LADDER


@pytest.mark.parametrize(
    "words, items",
    [
        (["box,room"], ("box", "room")),
        (["room?seed=3,17DRP5sb8fy.glb"], ("room?seed=3", "17DRP5sb8fy.glb")),
        (["box?size=4,3.,2.5e0&seed=1,box"], ("box?size=4,3.,2.5e0&seed=1", "box")),
        (["box", "room"], ("box", "room")),
        (["box, room,"], ("box", "room")),
        (["box?size=4,3,2.5,room"], ("box?size=4,3,2.5", "room")),
        (["box?size=4,3,2.5&seed=1,room?seed=2"], ("box?size=4,3,2.5&seed=1", "room?seed=2")),
        (["box?seed=1", "2.glb"], ("box?seed=1", "2.glb")),
        ([], ()),
    ],
)
def test_commas_and_spaces_separate_but_not_inside_a_scenes_numbers(words, items):
    assert split_list(words) == items


def test_seeds_may_be_a_range():
    assert parse_seeds(["0-2,7", "9-9"]) == (0, 1, 2, 7, 9)
    for wrong in ("2-0", "-1", "1-2-3", "0-99999", "1-", "²"):
        with pytest.raises(InputError, match="seed"):
            parse_seeds([wrong])


def test_the_name_of_a_file_stays_whole(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my, room?.glb").touch()
    words = ["my, room?.glb", "my, room?.glb?up=y&units=cm", "box,room"]
    assert split_scenes(words) == (*words[:2], "box", "room")
    assert split_scenes(["my, room?.glb?up=y,box?seed=2,room"]) == ("my, room?.glb?up=y", "box?seed=2", "room")
    folder = tmp_path / "Größe, 2" / "room_0"
    folder.mkdir(parents=True)
    words = [f"replica:{folder}?sequence=seq,box", str(folder.parent), "x" * 5000 + ",room"]
    assert split_scenes(words) == (f"replica:{folder}?sequence=seq", "box", str(folder.parent), "x" * 5000, "room")


def test_seeds():
    assert parse_seeds(["0,1", "7"]) == (0, 1, 7)
    for text in ("-1", "1.5", "x", "9" * 20, "9" * 5000):
        with pytest.raises(InputError, match="whole number"):
            parse_seeds([text])


def test_start():
    assert parse_start("-1,2,1.4,90") == (-1.0, 2.0, 1.4, 90.0)
    assert parse_start(None) is None
    for text in ("1,2,3", "1,2,3,north", "", "nan,0,1,0", "0,0,1e400,0"):
        with pytest.raises(InputError, match="x,y,z,yaw"):
            parse_start(text)


def test_overrides():
    words = ["sensor.width=96", "sensor.depth_noise=kinect", "a=True", "b=[0.0, 0.3]", "c=x=y"]
    assert parse_overrides(words) == {
        "sensor.width": 96, "sensor.depth_noise": "kinect", "a": True, "b": [0.0, 0.3], "c": "x=y"
    }  # fmt: skip
    assert parse_overrides(["a=.9", "b=-.5", "c=1.", "d=1.2.3", "e=."]) == {
        "a": 0.9, "b": -0.5, "c": 1.0, "d": "1.2.3", "e": "."
    }  # fmt: skip
    for value in ("[" * 100_000, '{"a":' * 10_000, "9" * 5000):
        with pytest.raises(InputError, match="--set 'a'( takes no such value|: lists and tables are JSON)"):
            parse_overrides([f"a={value}"])
    assert parse_overrides(['views.stages=[["pool"]]']) == {"views.stages": [["pool"]]}
    for value in ("[[pool]]", "{a: 1}"):
        with pytest.raises(InputError, match=r"--set 'views.stages': lists and tables are JSON, as in"):
            parse_overrides([f"views.stages={value}"])
    for word in ("sensor.width", "=3", "x" * 10_000):
        with pytest.raises(InputError, match="key=value"):
            parse_overrides([word])


def test_the_values_of_a_sweep_have_the_forms_of_overrides():
    words = ["mapper.seed_spacing=.06,0.12", "sensor.depth_noise=none,kinect", "a=True,2", "b=1"]
    assert parse_sweep(words) == {
        "mapper.seed_spacing": (0.06, 0.12), "sensor.depth_noise": ("none", "kinect"), "a": (True, 2), "b": (1,)
    }  # fmt: skip
    assert parse_sweep(['views.stages=[["pool", "turns"]],[["pool"]]']) == {
        "views.stages": ([["pool", "turns"]], [["pool"]])
    }
    for words, message in (
        (["sensor.width"], "--sweep takes key=value,value"),
        (["=3"], "--sweep takes key=value,value"),
        (["a="], "--sweep 'a' lacks a value, got ''"),
        (["a=1,,2"], "--sweep 'a' lacks a value, got '1,,2'"),
        (["a=1", "a=2"], "--sweep names 'a' twice"),
        (["views.stages=[[pool]],[[turns]]"], "--sweep 'views.stages': lists and tables are JSON"),
        (["a=" + "[" * 100_000], "--sweep 'a' takes no such value"),
    ):
        with pytest.raises(InputError, match=re.escape(message)):
            parse_sweep(words)


def test_groups_of_policies() -> None:
    assert split_policies(["random,ladder", "mine:Mine"]) == ("random", *LADDER, "mine:Mine")
    assert split_policies(["naruto?travel=shared,random"]) == ("naruto?travel=shared", "random")
    assert split_policies(["naruto?targets=300&travel=shared,random"])[1:] == ("random",)
    assert set(split_policies(["all"])) == set(POLICIES)
    with pytest.raises(InputError, match=r"did you mean 'ladder'\? `asg list policies` lists the names"):
        split_policies(["random,lader"])
    with pytest.raises(InputError, match="'reference:oracle' is not a policy: ask for it by --references oracle"):
        split_policies(["random,reference:oracle"])
    assert [rung.partition("?")[0] for rung in LADDER] == [*(f"activestructure-{x}" for x in "abcd"), "activestructure"]


def test_a_published_start_is_that_of_one_scene(monkeypatch):
    from activestructure_gym.scenes import datasets

    monkeypatch.setattr(datasets, "published_start", lambda scene: (1.0, 2.0, 1.5, 90.0))
    assert start_of("published", ["box"]) == (1.0, 2.0, 1.5, 90.0)
    assert start_of("1,2,3,4", ["a", "b"]) == (1.0, 2.0, 3.0, 4.0) and start_of(None, ["a", "b"]) is None
    with pytest.raises(InputError, match="takes one scene, got 2"):
        start_of("published", ["a", "b"])


def test_labels_are_split_at_the_last_equals_sign() -> None:
    assert parse_labels(["a=Ours", "room?seed=3=Room A"]) == {"a": "Ours", "room?seed=3": "Room A"}
    for wrong in ("a", "=Ours", "a=", "a= "):
        with pytest.raises(InputError, match="--labels takes NAME=TEXT"):
            parse_labels([wrong])
