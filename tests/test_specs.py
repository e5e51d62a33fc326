import copy
import pickle

import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.evaluation.archive.jobs import Job
from activestructure_gym.evaluation.running.comparison import Comparison
from activestructure_gym.specs import Spec, number_text, parse_options, typed_options


def make(path: str, *, depth: int = 3, wide: bool = False, size: tuple[float, float] = (1.0, 2.0), name: str = "a"):
    return path, depth, wide, size, name


class Maker:
    def __init__(self, depth: int, share: float | None = None) -> None: ...


class Plain:
    pass


def test_texts_become_what_the_annotations_say():
    given = parse_options("depth=7&wide=yes&size=3,4.5&name=b", "thing 'x'")
    assert typed_options("thing 'x'", make, given, apart=("path",)) == {
        "depth": 7, "wide": True, "size": (3.0, 4.5), "name": "b"
    }  # fmt: skip
    assert typed_options("thing 'x'", Maker, {"depth": "7", "share": "0.5"}) == {"depth": 7, "share": 0.5}
    assert typed_options("thing 'x'", Maker, {"depth": 8}) == {"depth": 8}  # no text: as it came


def test_a_plus_in_a_path_or_a_number_stays_one():
    assert parse_options("sequence=/a+b/c d&size=1e+2,3&name=x%26y", "thing 'x'") == {
        "sequence": "/a+b/c d", "size": "1e+2,3", "name": "x&y"
    }  # fmt: skip


def test_an_option_is_said_once():
    assert parse_options("depth=7&depth=7", "thing 'x'") == {"depth": "7"}
    with pytest.raises(InputError, match="'depth=7&depth=8' in thing 'x' says depth twice: 7 and 8"):
        parse_options("depth=7&depth=8", "thing 'x'")


@pytest.mark.parametrize("value", [2.0, -0.3, 90, 17.188733853924695, 1.2345678, 12345.678, 1e20, 1e-9])
def test_the_text_of_a_number_is_that_number(value):
    assert float(number_text(value)) == value and len(number_text(value)) <= len(repr(float(value)))


@pytest.mark.parametrize(
    "kind, query, message",
    [
        (make, "dpth=3", "unknown option 'dpth' of thing 'x'; did you mean 'depth'? Known: depth, name, size, wide"),
        (make, "depth=deep", "option depth of thing 'x' must be a whole number, got 'deep'"),
        (make, "wide=maybe", "option wide of thing 'x' must be true or false, got 'maybe'"),
        (make, "size=3", "option size of thing 'x' must be 2 values with commas, got '3'"),
        (make, "depth", "'depth' in thing 'x' is not of the form key=value&key=value"),
        (Maker, "", "thing 'x' needs the option depth (as in 'NAME?depth=...')"),
        (Plain, "depth=3&a=b", "thing 'x' takes no options, got 'depth=3&a=b'; remove them"),
    ],
)
def test_what_was_expected_and_what_came(kind, query, message):
    with pytest.raises(InputError) as error:
        typed_options("thing 'x'", kind, parse_options(query, "thing 'x'"), apart=("path",))
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("text", "kind", "place", "query"),
    [
        ("naruto?travel=shared", "registered", "", "travel=shared"),
        ("package.module:Mine?depth=3", "plug-in", "Mine", "depth=3"),
        ("learned:runs/bc@01234567", "checkpoint", "runs/bc@01234567", ""),
        ("trajectory:a/traj.txt?axes=opengl&mapper=splatam", "trajectory", "a/traj.txt", "axes=opengl&mapper=splatam"),
        ("reference:oracle", "reference", "oracle", ""),
        ("reference", "registered", "", ""),
    ],
)
def test_a_spec_says_of_what_kind_it_is_and_is_its_text_again(text, kind, place, query):
    spec = Spec(text)
    assert (spec.kind, spec.place, spec.query, str(spec)) == (kind, place, query, text)
    assert spec.options("it") == parse_options(query, "it")


@pytest.mark.parametrize("value", [3, None, ["box"]])
def test_a_name_that_is_no_text_is_refused_by_all_that_take_one(value):
    for make_one in (Spec, lambda name: Comparison([name], ["random"]), lambda name: Job("box", name, 0)):
        with pytest.raises(InputError, match="a name is given as a text, got"):
            make_one(value)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda spec: pickle.loads(pickle.dumps(spec))])
def test_a_copy_of_a_spec_keeps_its_parts(again):
    spec = again(Spec("naruto?travel=shared"))
    assert type(spec) is Spec and (spec.name, spec.query) == ("naruto", "travel=shared")
