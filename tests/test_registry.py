"""Names that plug in."""

from __future__ import annotations

import importlib
import importlib.metadata
import json

import pytest

from activestructure_gym import registry
from activestructure_gym.errors import InputError
from activestructure_gym.registry import Registry


def test_registered_imported_and_installed_names_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    things: Registry[object] = Registry("thing", "things")
    assert things.register("mine")(42) == 42
    assert things.get("mine") == 42
    import math

    assert things.get("math:pi") == math.pi
    point = importlib.metadata.EntryPoint("installed", "math:e", "activestructure_gym.things")
    monkeypatch.setattr(registry, "installed", lambda group: [point] if group == point.group else [])
    assert things.get("installed") == math.e
    assert list(things) == ["installed", "mine"]
    assert "mine" in things and "other" not in things


def test_a_name_belongs_to_one_file(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or two versions of a planner in one process would both have the feature that was imported last."""
    things: Registry[object] = Registry("thing", "things")
    for name in ("asg_first_version", "asg_second_version"):
        (tmp_path / f"{name}.py").write_text("def gain(): pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    first, second = map(importlib.import_module, ("asg_first_version", "asg_second_version"))
    things.register("gain")(first.gain)
    things.register("gain")(first.gain)  # executed again
    with pytest.raises(
        InputError, match="'gain' of the module asg_second_version is already registered by asg_first_v"
    ):
        things.register("gain")(second.gain)
    second.__file__ = first.__file__  # as __main__ and the module of its own name
    things.register("gain")(second.gain)
    with pytest.raises(InputError, match="register takes a name, as in .*got <function"):
        things.register(first.gain)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mien", "unknown thing 'mien'; did you mean 'mine'? Known: mine"),
        ("nowhere.at_all:x", "thing 'nowhere.at_all:x': there is no module called 'nowhere' on sys.path"),
        (":", "thing ':' is neither a known name nor of the form package.module:Name"),
        ("a:b:c", "thing 'a:b:c' is neither a known name nor of the form package.module:Name"),
        ("sys:tau_and_a_half", "thing 'sys:tau_and_a_half': module 'sys' has no 'tau_and_a_half'"),
        (
            "json:lods",
            f"thing 'json:lods': module 'json', which is {json.__file__}, has no 'lods'; did you mean 'loads'?",
        ),
    ],
)
def test_a_wrong_name_gets_one_sentence(name: str, message: str) -> None:
    things: Registry[object] = Registry("thing", "things")
    things.register("mine")(1)
    with pytest.raises(InputError) as error:
        things.get(name)
    assert str(error.value) == message


def test_a_slip_of_the_pen_is_named_with_its_line(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "asg_misspelt_plug_in.py").write_text("import math\ndef x(:\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match=r"cannot be imported: '.*asg_misspelt_plug_in.py', line 2: "):
        Registry("thing", "things").get("asg_misspelt_plug_in:x")


def test_an_error_inside_a_plug_in_stays_what_it_is(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "asg_broken_plug_in.py").write_text("import math\nmath.tau_and_a_half\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(AttributeError, match="tau_and_a_half"):
        Registry("thing", "things").get("asg_broken_plug_in:x")


def test_a_family_makes_entries_from_their_names() -> None:
    things: Registry[str] = Registry("thing", "things")
    assert things.register_family("made")(str.upper) is str.upper
    assert things.get("made:of/wood?or=not") == "OF/WOOD?OR=NOT"
    things.register("made:known")("registered")
    assert things.get("made:known") == "registered"
    assert list(things) == ["made:known"]
    with pytest.raises(InputError, match="unknown thing 'made'"):
        things.get("made")


@pytest.mark.parametrize("name", [1, None, ["mine"], b"mine"])
def test_a_name_is_a_text(name: object) -> None:
    with pytest.raises(InputError, match="a thing is given by its name, as a text, got"):
        Registry("thing", "things").get(name)  # type: ignore[arg-type]


def test_an_entry_of_another_kind_is_refused_however_it_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    things: Registry[object] = Registry("thing", "things", fits=callable, wanted="a function")
    things.register("mine")("a text")
    things.register_family("made")(str.upper)
    point = importlib.metadata.EntryPoint("installed", "math:e", "activestructure_gym.things")
    monkeypatch.setattr(registry, "installed", lambda group: [point])
    for name in ("mine", "made:of wood", "math:pi", "installed"):
        with pytest.raises(InputError, match=f"thing '{name}' must be a function, got"):
            things.get(name)


def test_code_that_a_file_names_is_refused_unless_files_are_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    things: Registry[str] = Registry("thing", "things")
    things.register("mine")("")
    things.register("with:colon")("")
    things.register_family("made")(str.upper)
    assert [name for name in ("mine", "with:colon", "made:of", "math:pi", "other") if things.imports(name)] == [
        "math:pi"
    ]
    with pytest.raises(InputError, match="'a.json' names the thing 'math:pi', and to load it would run code"):
        registry.refuse_code("thing", "math:pi", "a.json")
    monkeypatch.setenv(registry.TRUST, "1")
    registry.refuse_code("thing", "math:pi", "a.json")
