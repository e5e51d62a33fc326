import pytest

from activestructure_gym.errors import InputError
from activestructure_gym.specs import parse_options, typed_options


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


@pytest.mark.parametrize(
    "kind, query, message",
    [
        (make, "dpth=3", "unknown option of thing 'x' 'dpth'; did you mean 'depth'? Known: depth, name, size, wide"),
        (make, "depth=deep", "option depth of thing 'x' must be int, got 'deep'"),
        (make, "wide=maybe", "option wide of thing 'x' must be bool, got 'maybe'"),
        (make, "size=3", "option size of thing 'x' must be 2 values with commas, got '3'"),
        (make, "depth", "'depth' in thing 'x' is not of the form key=value&key=value"),
        (Maker, "", "thing 'x' needs the option depth (as in 'NAME?depth=...')"),
        (Plain, "depth=3&a=b", "thing 'x' takes no options, got 'depth=3&a=b'; leave them away"),
    ],
)
def test_what_was_expected_and_what_came(kind, query, message):
    with pytest.raises(InputError) as error:
        typed_options("thing 'x'", kind, parse_options(query, "thing 'x'"), apart=("path",))
    assert str(error.value) == message
