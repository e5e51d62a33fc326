"""What there is by name: complete, readable, and the same for programs."""

import dataclasses
import json

import pytest

from activestructure_gym.config import ReconstructionConfig, configure
from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.cli import main
from activestructure_gym.evaluation.cli.config import field_notes, leaves, meanings
from activestructure_gym.features import FEATURES
from activestructure_gym.mapping import MAPPERS
from activestructure_gym.policies import POLICIES, Policy, make_policy
from activestructure_gym.worlds import WORLDS


@pytest.fixture(autouse=True)
def a_log(monkeypatch):
    """Whoever runs the tests may have told how wide his terminal is."""
    monkeypatch.delenv("COLUMNS", raising=False)


def said(capsys, *words):
    assert main(list(words)) == 0
    return capsys.readouterr().out


def test_every_policy_of_ours_says_what_it_decides_by_and_whose_it_is(capsys):
    out = said(capsys, "policies")
    for name in POLICIES:
        kind = POLICIES.get(name)
        if kind.__module__.startswith("activestructure_gym"):
            assert kind.criterion and kind.source, name
            assert f"\n{name} " in out and kind.criterion in out
    wide = said(capsys, "policies", "--wide")
    assert all(POLICIES.get(name).source in wide for name in POLICIES)
    assert "shared/research" not in out and "docs/" not in out


@pytest.mark.parametrize("name", list(POLICIES))
def test_a_policy_is_described(name, capsys):
    out = said(capsys, "policies", name)
    assert out.startswith(name) and "Features it needs:" in out
    assert "shared/research" not in out and "docs/" not in out and "peers_" not in out


def test_a_policy_s_options_stand_with_their_defaults(capsys):
    out = said(capsys, "policies", "activeinr?uncertainty=proxy")
    assert "uncertainty" in out and "perturbation" in out and "written as in 'activeinr?travel=...', in quotes" in out
    assert "activeinr_proxy" in out
    facts = json.loads(said(capsys, "policies", "activeinr", "--json"))
    assert facts["options"] == {"travel": "native", "uncertainty": "perturbation"}
    assert facts["features"][0] == "activeinr"


def test_policies_for_programs(capsys):
    rows = json.loads(said(capsys, "policies", "--json"))
    assert [row["name"] for row in rows] == list(POLICIES)
    assert {"name", "criterion", "features", "travel_term", "source", "native", "options", "required", "about"} == set(
        rows[0]
    )


def test_a_policy_says_what_it_brings_in_the_native_setup(capsys):
    out = " ".join(said(capsys, "policies", "activesplat").split())
    mapper, camera = "mapper splatam, 2 iterations a keyframe", "sensor.width = 256, sensor.height = 256"
    assert "Native settings: views of nodes?rows=476 + turns" in out
    assert f"up to 512 of them, {mapper}, {camera}, sensor.max_range = 10.0, mapper.isotropic" in out
    assert "Native settings: views of nodes?rows=476 + turns" in " ".join(
        said(capsys, "policies", "random?views_of=activesplat").split()
    )
    assert "Native settings: nothing." in said(capsys, "policies", "hole_area")


def test_several_policies_are_described_one_after_the_other(capsys):
    out = said(capsys, "policies", "pixel_only,frontier", "random")
    assert [out.index(f"{name}  ") for name in ("pixel_only", "frontier", "random")] == sorted(
        out.index(f"{name}  ") for name in ("pixel_only", "frontier", "random")
    )
    assert [facts["name"] for facts in json.loads(said(capsys, "policies", "random", "pixel_only", "--json"))] == [
        "random", "pixel_only"
    ]  # fmt: skip


@pytest.mark.parametrize("words", [["policies"], ["features"], ["config"]])
def test_lists_fold_at_the_width_of_a_terminal(capsys, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "80")
    lines = said(capsys, *words).splitlines()
    assert max(map(len, lines)) <= 80
    monkeypatch.delenv("COLUMNS")
    log = said(capsys, *words).splitlines()
    assert max(map(len, log)) > 100  # a log is not shortened
    assert not any(line.endswith(" ") or " " * 60 in line for line in log)


def test_a_feature_is_described_with_its_columns_and_who_asks_for_it(capsys):
    out = said(capsys, "features", "naruto_look", "unknown_volume_way")  # a column stands for its feature
    assert "30" in out and "Needed by: naruto" in out
    assert "all keyframes of the path" in out and "activestructure" in out
    assert [row["name"] for row in json.loads(said(capsys, "features", "pixel", "--json"))] == ["pixel"]
    assert main(["features", "pixle"]) == 2
    assert "did you mean 'pixel'" in capsys.readouterr().err


def test_of_a_configuration_some_fields_are_printed(capsys):
    assert "sensor.width" in (out := said(capsys, "config", "sensor")) and "mapper." not in out
    out = said(capsys, "config", "fast", "sensor.width,mapper.window")
    assert " 96 " in out and "mapper.window" in out and "sensor.height" not in out
    assert main(["config", "fast", "sensor.widht"]) == 2
    assert "did you mean 'sensor.width'" in capsys.readouterr().err


def test_a_policy_of_a_user_without_any_of_it_is_listed(capsys, monkeypatch):
    class Mine(Policy):
        """Goes [red]there."""

        def __init__(self, where: str) -> None: ...

        def act(self, observation):
            return 0

    monkeypatch.setitem(POLICIES._entries, "mine", Mine)
    assert "Goes [red]there." in said(capsys, "policies")
    assert main(["policies", "mine"]) == 0
    assert main(["policies", "mihne"]) == 2
    assert "did you mean 'mine'" in capsys.readouterr().err
    with pytest.raises(ValueError):
        make_policy("mine")


def test_a_policy_is_described_by_its_own_words_and_what_must_be_given_is_said(capsys, monkeypatch):
    class Mute(Policy):
        required_features = "pixel"

        def __init__(self, where: str, far: int = 2) -> None: ...

        def act(self, observation):
            return 0

    monkeypatch.setitem(POLICIES._entries, "mute", Mute)
    assert main(["policies", "mute"]) == 2
    assert "required_features of Mute must be a tuple of names, got 'pixel'" in capsys.readouterr().err
    with pytest.raises(InputError, match="policy 'mute.where=x': required_features of Mute must be a tuple of names"):
        make_policy("mute?where=x")
    Mute.required_features = ("pixel",)
    out = said(capsys, "policies", "mute")
    assert "Chooses one row" not in out and "pixel" in out
    assert [line.split() for line in out.splitlines()[-4:-2]] == [["where", "must", "be", "given"], ["far", "2"]]
    facts = json.loads(said(capsys, "policies", "mute", "--json"))
    assert facts["required"] == ["where"] and facts["about"] == facts["criterion"] == ""
    assert main(["policies", "activeinr?travel=fast"]) == 2
    assert "travel" in capsys.readouterr().err


def test_every_feature_has_units_and_a_line(capsys):
    rows = json.loads(said(capsys, "features", "--json"))
    assert [row["name"] for row in rows] == list(FEATURES)
    for row in rows:
        if FEATURES.get(row["name"]).__module__.startswith("activestructure_gym."):
            assert row["about"] and all(unit and unit != "-" for unit in row["units"]), row["name"]
            assert len(row["columns"]) == len(row["units"]) == len(row["low"]) == len(row["high"])
    assert not any("shared/research" in row["about"] or "partial(" in row["about"] for row in rows)
    out = said(capsys, "features", "--wide")
    assert "0_x, 0_y .. 9_z (30)" in out and "naruto_look" in out and "hole_area" in out


@pytest.mark.parametrize("preset", ["default", "fast", "full", "paper"])
def test_the_configuration_is_printed_whole(preset, capsys):
    out = said(capsys, "config", preset)
    for name, _ in leaves(ReconstructionConfig()):
        assert f"\n{name} " in out
    recorded = json.loads(said(capsys, "config", preset, "--json"))
    assert configure("default", recorded) == configure(preset)


def test_what_set_changes_is_said(capsys):
    out = said(capsys, "config", "fast", "--set", "sensor.width=64", "views.heights_m=[0.0, 0.5]")
    assert "--set sensor.width: 96 -> 64\n--set views.heights_m: [0.0] -> [0.0, 0.5]\n" in out
    assert main(["config", "--set", "sensor.widht=64"]) == 2
    assert main(["config", "fats"]) == 2
    assert capsys.readouterr().err.count("did you mean") == 2


def test_every_field_has_a_meaning():
    assert not [name for name, note in meanings(ReconstructionConfig()) if not note]


@pytest.mark.parametrize("name", list(MAPPERS))
def test_every_mapper_s_fields_are_listed_with_a_meaning(capsys, name):
    found = json.loads(said(capsys, "config", "--set", f"mapper.name={name}", "--json"))
    assert set(found["mapper"]) == {field.name for field in dataclasses.fields(MAPPERS.get(name))}
    assert said(capsys, "config", "--set", f"mapper.name={name}").count("\nmapper.") >= len(found["mapper"])
    assert all(meaning for _, meaning in meanings(ReconstructionConfig(mapper=MAPPERS.get(name))))


def test_notes_are_read_wherever_they_stand():
    @dataclasses.dataclass
    class Thing:
        # Above,
        # in two lines.
        above: int = 1
        behind: int = 2  # behind
        below: int = 3
        """Below,
        and on."""
        none: int = 4

    notes = field_notes(Thing)
    assert (notes["above"], notes["behind"]) == ("Above, in two lines.", "behind")
    assert (notes["below"], notes["none"]) == ("Below, and on.", "")


def test_scenes_for_programs(capsys):
    rows = json.loads(said(capsys, "scenes", "--json"))
    assert {"name": "apartment", "options": rows[0]["options"]} == rows[0] and rows[0]["options"]["rooms"] == 3


def test_every_list_has_a_short_name(capsys):
    for words in (
        ["policies"],
        ["policies", "naruto"],
        ["scenes"],
        ["features", "pixel"],
        ["config", "fast"],
    ):
        assert said(capsys, "list", *words) == said(capsys, *words)


def test_worlds_are_listed_with_their_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "worlds"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in WORLDS) and "asg explore --world" in said
    assert main(["list", "worlds", "simulated", "--json"]) == 0
    (facts,) = json.loads(capsys.readouterr().out)
    assert facts["name"] == "simulated" and facts["options"].startswith("scene=room&width=160")
    assert main(["worlds", "recorded"]) == 0
    assert capsys.readouterr().out.startswith("recorded?path&")
    assert main(["list", "worlds", "nowhere"]) == 2
    assert "unknown world 'nowhere'" in capsys.readouterr().err
