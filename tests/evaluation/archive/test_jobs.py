import json
from dataclasses import replace

import numpy as np
import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive import jobs
from activestructure_gym.evaluation.archive.conditions import Conditions
from activestructure_gym.evaluation.archive.jobs import (
    Job,
    absolute_spec,
    ranked_among,
    refuse_code,
    scene_label,
    scene_labels,
    slug,
)
from activestructure_gym.evaluation.protocols import StandardProtocol
from activestructure_gym.specs import Spec

JOB = Job(
    "room",
    "random",
    3,
    scene_hash="abc",
    conditions=Conditions(overrides={"sensor.width": 96, "mapper.iterations": 2}),
)


def test_a_job_survives_json():
    job = Job(
        "a.glb",
        "p:Q",
        1,
        conditions=Conditions(frame_budget=7, start_pose=(1, 2, 3, 4), protocol=StandardProtocol(views=3)),
    )
    assert Job.from_dict(json.loads(json.dumps(job.as_dict()))) == job
    assert Job.from_dict(json.loads(json.dumps(JOB.as_dict()))).hash == JOB.hash


def test_the_hash_does_not_depend_on_the_order_of_overrides_nor_on_how_the_scene_is_named():
    turned = Job(
        "room",
        "random",
        3,
        scene_hash="abc",
        conditions=Conditions(overrides=dict(reversed(JOB.conditions.overrides.items()))),
    )
    assert turned == JOB
    assert Job("other/path/to/it", "random", 3, "abc", JOB.conditions).hash == JOB.hash


@pytest.mark.parametrize(
    "change",
    [
        {"policy": "pixel_only"},
        {"policy": "random?travel=shared"},
        {"seed": 4},
        {"scene_hash": "abd"},
        {"conditions": replace(JOB.conditions, preset="fast")},
        {"conditions": replace(JOB.conditions, frame_budget=10)},
        {"conditions": replace(JOB.conditions, overrides={})},
        {"conditions": replace(JOB.conditions, start_pose=(0.0, 0.0, 1.0, 0.0))},
        {"conditions": replace(JOB.conditions, protocol=StandardProtocol(opacity_threshold=0.4))},
    ],
)
def test_whatever_decides_the_numbers_is_in_the_hash(change):
    assert replace(JOB, **change).hash != JOB.hash


def test_the_hash_is_the_same_in_every_process_and_release(monkeypatch):
    # Written down once. Whoever moves it makes every stored result of the same version unfindable.
    monkeypatch.setattr(jobs, "__version__", "test")
    job = Job("box", "random", 0, scene_hash="0" * 64)
    assert job.hash == "51f1161c8d81"
    assert Job.from_dict(job.as_dict()) == job


def test_swept_values_are_part_of_a_job_and_an_unswept_job_is_as_it_was(monkeypatch):
    monkeypatch.setattr(jobs, "__version__", "test")
    plain = Job("box", "random", 0, scene_hash="0" * 64)
    assert "swept" not in plain.as_dict() and plain.name == "box--random--seed0--51f1161c8d81"
    changes = {"mapper.seed_spacing": 0.1, "sensor.width": 96}
    job = replace(plain, conditions=Conditions(overrides=changes), swept=("mapper.seed_spacing",))
    content = json.loads(json.dumps(job.as_dict()))
    # The value is stored apart from the overrides, and acts as one of them.
    assert content["swept"] == {"mapper.seed_spacing": 0.1} and content["overrides"] == {"sensor.width": 96}
    assert Job.from_dict(content) == job and job.conditions.changes(None) == changes
    assert job.shared_conditions.overrides == {"sensor.width": 96} and job.swept_values == content["swept"]
    assert job.title == "box · random [mapper.seed_spacing=0.1] · seed 0"
    assert job.name == f"box--random-mapper.seed_spacing-0.1--seed0--{job.hash}"
    other = replace(job, conditions=Conditions(overrides=changes | {"mapper.seed_spacing": 0.2}))
    assert len({plain.hash, job.hash, other.hash, replace(job, swept=()).hash}) == 4
    two = replace(job, swept=("sensor.width", "mapper.seed_spacing"))
    assert two.label == "random [sensor.width=96, mapper.seed_spacing=0.1]"
    assert two.hash == replace(two, swept=two.swept[::-1]).hash  # the order of the fields does not matter
    with pytest.raises(InputError, match="swept value .* has a line break"):
        replace(job, conditions=Conditions(overrides={"a": "x\ny"}), swept=("a",))


def test_wrong_numbers_are_refused():
    with pytest.raises(InputError, match="frame budget must be at least 1, got 0"):
        Job("box", "random", 0, conditions=Conditions(frame_budget=0))
    with pytest.raises(InputError, match="seed"):
        Job("box", "random", -1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"frame_budget": 20.5}, "frame budget must be a whole number, got 20.5"),
        ({"frame_budget": "20"}, "whole number, got '20'"),
        ({"frame_budget": True}, "whole number, got True"),
        ({"overrides": 5}, "overrides are values by field"),
        ({"protocol": "standard"}, "protocol must be StandardProtocol"),
        ({"also": 5}, "also is a list of names"),
        ({"metrics": "mine:worst"}, "metrics is a list of names"),
        ({"start_pose": (1.0, 1.0)}, "a start pose is x, y, z"),
        ({"start_pose": np.eye(4)}, "a start pose is x, y, z"),
        ({"start_pose": ("a", 0, 0, 0)}, "a start pose is x, y, z"),
        ({"start_pose": 5}, "a start pose is x, y, z"),
    ],
)
def test_conditions_of_another_kind_are_refused(given, message):
    with pytest.raises(InputError, match=message):
        Conditions(**given)


def test_numbers_of_numpy_make_the_same_job():
    def job(whole, number, pose):
        return Job(
            "box", "random", whole(0),
            conditions=Conditions(
                frame_budget=whole(20),
                overrides={"mapper.iterations": whole(3), "mapper.seed_spacing": number(0.1)},
                start_pose=pose((1.0, 1.0, 1.2, 0.0)),
                protocol=StandardProtocol(views=whole(3), threshold_m=number(0.05)),
            ),
            swept=("mapper.iterations",),
        )  # fmt: skip

    plain, of_numpy = job(int, float, tuple), job(np.int64, np.float64, np.array)
    assert of_numpy.hash == plain.hash and Job.from_dict(of_numpy.as_dict()) == plain == of_numpy
    assert json.loads(json.dumps(of_numpy.as_dict())) == plain.as_dict()


def test_a_result_of_another_protocol_version_is_not_mixed_in():
    content = JOB.as_dict()
    content["protocol"]["version"] = 99
    with pytest.raises(InputError, match="version 99"):
        Job.from_dict(content)


@pytest.mark.parametrize(
    "spec, label",
    [
        ("room", "room"),
        ("apartment?seed=3&rooms=4", "apartment?seed=3&rooms=4"),
        ("some/where/hotel_room.glb", "hotel_room"),
        ("some/where/house.obj?units=cm", "house?units=cm"),
        ("replica:data/room_0", "room_0"),
        ("my_scene:cube_room?side=5", "cube_room?side=5"),
        ("data/room_0?sequence=/somewhere/else/seq_0", "room_0?sequence=seq_0"),
        (".", "."),
        ("/", "/"),
    ],
)
def test_short_names_of_scenes(spec, label):
    assert scene_label(spec) == label


def test_files_of_one_name_are_told_apart():
    labels = scene_labels(dict.fromkeys(("a/scene.glb", "b/scene.glb", "room"), ""))
    assert labels == {"a/scene.glb": "a/scene", "b/scene.glb": "b/scene", "room": "room"}
    # However deep they lie, the place of neither is told; nor where only folders in options differ.
    deep = [f"/home/me/{name}/1/2/3/4/scene.glb" for name in "ab"]
    assert list(scene_labels(dict.fromkeys(deep, "")).values()) == ["a/1/2/3/4/scene", "b/1/2/3/4/scene"]
    options = [f"room.glb?sequence=/home/{name}/views" for name in "ab"]
    labels = scene_labels(dict.fromkeys(options, ""))
    assert list(labels.values()) == ["room?sequence=views (1)", "room?sequence=views (2)"]


def test_a_label_never_holds_a_whole_path():
    assert scene_label("/scene.glb", parts=3) == "scene"
    files = [f"/{disk}/home/me/sets/scene.glb" for disk in "abc"]
    labels = scene_labels({spec: digit * 64 for spec, digit in zip(files, "122")})
    assert labels == dict(zip(files, ["scene@11111111", "scene@22222222 (1)", "scene@22222222 (2)"]))


def test_files_are_found_from_any_directory(tmp_path, monkeypatch):
    (tmp_path / "house.obj").touch()
    monkeypatch.chdir(tmp_path)
    assert absolute_spec("house.obj?units=cm") == f"{tmp_path}/house.obj?units=cm"
    assert absolute_spec("house.obj?sequence=./house.obj") == f"{tmp_path}/house.obj?sequence={tmp_path}/house.obj"
    assert absolute_spec("mesh:house.obj") == f"mesh:{tmp_path}/house.obj"
    assert absolute_spec("room?seed=1") == "room?seed=1"


@pytest.mark.parametrize("spec", ["room", "room?seed=3"])
def test_a_registered_scene_stays_one_beside_a_folder_of_its_name(spec, tmp_path, monkeypatch):
    (tmp_path / "room").mkdir()
    monkeypatch.chdir(tmp_path)
    assert absolute_spec(spec) == spec
    assert absolute_spec(f"./{spec}").startswith(str(tmp_path))


def test_planners_have_ranks_and_trajectories_where_nobody_plans():
    given, seeing = map(Spec, ("trajectory:sweep", "reference:oracle"))
    assert ranked_among([Spec("random"), given, seeing, Spec("hole_area")]) == {"random", "hole_area"}
    assert ranked_among([given, seeing]) == {given}
    assert ranked_among([seeing]) == set()


def test_run_directory_names_work_on_any_system():
    job = Job("my_scene:cube?side=5&x=a/b", "my_policy:Mine", 0)
    assert set(job.name) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")
    assert job.name.endswith(job.hash)
    assert slug("../..") == "unnamed"
    assert Job("room", "naruto?travel=shared", 0).name.startswith("room--naruto-travel-shared--seed0--")


@pytest.mark.parametrize("change", [{"scene": "a\nb.glb"}, {"policy": "random?a=\x1b[2J"}, {"scene": "\u2028"}])
def test_names_that_no_table_can_hold_are_refused_before_anything_runs(change):
    with pytest.raises(InputError, match="has a line break or a control character in its name: rename it") as error:
        Job(**({"scene": "room", "policy": "random", "seed": 0} | change))
    assert len(str(error.value).splitlines()) == 1


def test_a_run_directory_s_name_fits_into_a_file_system():
    assert len(Job("a" * 250 + ".glb", "p:" + "b" * 250, 2**62).name) <= 255


@pytest.mark.parametrize(
    "change, what",
    [
        ({"scene": "subprocess:getoutput?cmd=touch hacked"}, "scene"),
        ({"scene": "room:getoutput"}, "scene"),  # a generated scene's name is no reader's
        ({"policy": "os:system?command=touch hacked"}, "policy"),
        ({"policy": "random?views_of=os:system"}, "policy"),
        ({"conditions": Conditions(overrides={"features": ["pixel", "os:system"]})}, "feature"),
        ({"conditions": Conditions(overrides={"features": "os:system"})}, "feature"),
        ({"conditions": Conditions(overrides={"mapper.name": "os:system"})}, "mapper"),
        ({"conditions": Conditions(overrides={"mapper": {"name": "os:system"}})}, "mapper"),
        ({"conditions": Conditions(overrides={"mapper.backend": "os:system"})}, "splatting backend"),
        ({"conditions": Conditions(overrides={"sensor": {"backend": "os:system"}})}, "sensor backend"),
        ({"conditions": Conditions(also=("os:system",))}, "protocol"),
    ],
)
def test_what_a_record_names_is_not_imported(change, what, monkeypatch):
    job = Job(**({"scene": "room", "policy": "random", "seed": 0} | change))
    with pytest.raises(InputError, match=f"'compare.json' names the {what} .* add --trust-code"):
        refuse_code([JOB, job], "compare.json")
    monkeypatch.setenv("ASG_TRUST_CODE", "1")
    refuse_code([job], "compare.json")


@pytest.mark.parametrize("scene", ["room?seed=3", "a/b.glb?up=y", "mesh:c:d.obj", "replica:room_0", "nothing_known"])
@pytest.mark.parametrize("policy", ["random", "naruto?travel=shared", "learned:runs/bc@01234567"])
def test_registered_names_and_files_are_taken_from_a_record(scene, policy):
    refuse_code([Job(scene, policy, 0, conditions=Conditions(overrides=(("features", ["pixel"]),)))], "compare.json")


@pytest.mark.parametrize("seed", [0.5, True, "1", -1, None])
def test_a_seed_is_a_whole_number(seed):
    with pytest.raises(InputError, match="a seed is a whole number from 0 to"):
        Job(Spec("box"), Spec("random"), seed)


def test_a_seed_of_numpy_is_one_of_python():
    job = Job(Spec("box"), Spec("random"), np.int64(3))
    assert type(job.seed) is int and job == Job(Spec("box"), Spec("random"), 3)
